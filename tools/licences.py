"""The licence of each library that users install. `python tools/licences.py` prints them."""

import re
from importlib.metadata import distribution

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

#: What a licence may be: all but copyleft for the whole program (GPL, AGPL); the MPL binds its own files alone.
ALLOWED = re.compile(
    r"\b(0BSD|Apache|BSD|CC0|ISC|MIT|MPL[- ]2|Mozilla Public License 2|PSF|Python Software Foundation|Unlicense"
    r"|Zlib)\b",
    re.IGNORECASE,
)
FORBIDDEN = re.compile(r"GPL|General Public|AGPL|SSPL|Commons Clause|proprietary|non-?commercial", re.IGNORECASE)
#: Those whose packages do not say it in their metadata, as read in their sources.
READ = {
    "apsw": "Zlib OR any OSI-approved licence (its LICENSE: any-OSI)",
    "embreex": "BSD-2-Clause (its LICENSE)",
    "pypatchworkpp": "BSD-2-Clause (LICENSE of url-kaist/patchwork-plusplus, the wheel has none)",
}


def libraries(extras=("all",)):
    """The names of all that is installed with fidpipe and its extras but those of development, sorted."""
    found, todo = set(), [("fidpipe", frozenset(extras))]
    while todo:
        name, wanted = todo.pop()
        for text in distribution(name).requires or []:
            requirement = Requirement(text)
            applies = requirement.marker is None or any(
                requirement.marker.evaluate({"extra": extra}) for extra in (wanted or {""})
            )
            item = canonicalize_name(requirement.name), frozenset(requirement.extras)
            if applies and item not in found:
                found.add(item)
                todo.append(item)
    return sorted({name for name, _ in found} - {"fidpipe"})


def licence(name):
    """What a library says of its licence: SPDX expression, else classifiers, else the first line of the text."""
    if name in READ:
        return READ[name]
    metadata = distribution(name).metadata
    kinds = [word.rpartition(" :: ")[2] for word in metadata.get_all("Classifier") or [] if "License ::" in word]
    said = metadata.get("License-Expression") or "; ".join(kinds) or metadata.get("License") or "unknown"
    return said.strip().splitlines()[0]


def is_allowed(said):
    """Whether all licences that are said to hold are of those that we take; what is not known is none."""
    parts = re.split(r"\bAND\b|;", said)
    return all(ALLOWED.search(part) for part in parts) and not FORBIDDEN.search(said)


if __name__ == "__main__":
    for library in libraries():
        print(f"{library:24} {licence(library)}")
