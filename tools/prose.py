"""Expressions that a reader trips over, and what to write instead.

    python tools/prose.py                   everything that has to be clean; exits with 1 if anything is found
    python tools/prose.py PATH...           these files or folders
    python tools/prose.py --counts [PATH]   how many of each expression, everywhere

It reads text and headings of Markdown (no code), text of HTML templates, and docstrings, comments and strings of
Python and JavaScript. It prints file:line, the words found, and the suggestion. To keep an expression that is right in
its place (a quotation, a term of the field), put it into backticks or rephrase.
"""

import ast
import re
import sys
import tokenize
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CHECKED = ("README.md", "SECURITY.md", "runs/README.md", "docs", "pipeline", "stages", "schemas")
#: Regular expressions, without case, and what to write instead.
EXPRESSIONS = {
    r"wanted|unwanted": "expected X; requested; stale",
    r"(?<!there )(is|are|was|were) no (?!longer|more\b)\w+": "is not an X",
    r"(?<!there )(is|are) (?-i:none)|(?-i:none) (is|are)(?! (left|needed|found))": "is not one; is not a number",
    r"there already|(?<!\w )(is|are) there (and|or)\b|(is|are) there(?=[,;.:])": "exists, already exists",
    r"refus(es?|ed|ing)(?! to)|refusals?": "rejects; raises E if ...",
    r"faults?(?! (toleran|inject))": "error, problem",
    r"(came|comes?) to nothing": "failed",
    r"mend(s|ed|ing)?": "fix",
    r"(is|was|be) said|what .{1,20} says?": "message; summary of X",
    r"told|tells?|telling": "reports, shows; observable",
    r"judge[sd]?|judging": "evaluates, checks",
    r"ask(s|ed|ing)? for": "requests",
    r"(made|make|makes|making)( \w+){0,3} again": "recomputed, rebuilt",
    r"learnt": "inspection result",
    r"(?<!in )facts?": "metadata, inspection result",
    r"where there (is|are) (none|no\b|nothing)|(none|null|nan) where(?! \w+ =)": "None if ...; if absent",
    r"what is there|still right": "up-to-date results",
    r"(is|are|be|was|were) whole|whole or not at all": "intact, complete; atomic",
    r"believe[sd]?|believing": "trusts, accepts",
    r"(stand|stands|stood) (in|under|beside|here|there|on|at|once|as)": "is in, appears in",
    r"as (it|they) lies?": "as is, as given",
    r"besides?": "next to; in addition to",
    r"nobody('s)?|whoever|whichever|whatever": "orphaned; regardless of X; (name it)",
    r"go(es)? on|going on|went on": "continues, resumes",
    r"(is|are) other|other than (before|now)": "has changed, differs",
    r"in words(?!\))": "as text, human-readable",
    r"(divided|written|made|named|cut|given|read) otherwise": "differently",
    r"alike": "identical; in the same way",
    r"anew|afresh": "again; re-",
    r"by (itself|themselves)": "independently; on its own",
    r"in force": "effective, current",
    r"the set (seed|one|value)": "the configured seed",
    r"so many(-?th)?": "N, the number of; every Nth",
    r"how often": "number of; probability that",
    r"(files?|minutes?|seconds?|rows?|bytes|points|lines?|inputs|ms|mb|mib|gib|workers?) an? "
    r"(pair|run|scan|side|reader|row|file|frame|job|worker|process|object|folder|second|line|table|core)": "X per pair",
    r"less (r_lambda|cdc|its|that of|what)": "minus",
    r"(to be|not be) had|for want of": "is not available; for lack of",
    r"distances? of others": "baseline metrics",
    r"measured again": "re-measured",
    r"divided(?! by [^i])": "partitioned",
    r"crumbs?": "small components",
    r"(is|are|be) turned(?! (on|off))": "rotated; converted (axes)",
    r"own vehicle": "ego vehicle",
    r"made (data|streets?|scans?|scenes?)": "synthetic data",
    r"sways?": "depends on, affects",
    r"mean harm|withstands?": "untrusted input; fault tolerance",
    r"(upper|lower|these|three) (rooms?|floors)": "package layout, package",
    r"the same of": "(repeat the noun)",
    r"of (its|their) own": "separate, dedicated",
    r"(is|be) to be known": "note, remark",
    r"speaks? of": "declares, mentions",
    r"but for (?!example)": "except",
}
#: Of docstrings: the first word.
OPENINGS = {r"(What|Whether|How|Where|Which|Why|Who|Of)\b": "a noun phrase; True if ...", r"Gives\b": "Return"}
_WORDS = {re.compile(rf"(?<![\w`/.-])({pattern})(?![\w`/(-])", re.I): text for pattern, text in EXPRESSIONS.items()}
_FIRST = {re.compile(pattern): text for pattern, text in OPENINGS.items()}


def texts(path):
    """Pairs of line number and text; the text of a docstring begins with its quotes."""
    content = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        with path.open(encoding="utf-8") as file:
            yield from (
                (t.start[0], t.string) for t in tokenize.generate_tokens(file.readline) if t.type == tokenize.COMMENT
            )
        tree = ast.parse(content)
        documented = [n for n in ast.walk(tree) if isinstance(n, ast.Module | ast.ClassDef | ast.FunctionDef)]
        docs = {id(n.body[0].value) for n in documented if n.body and isinstance(n.body[0], ast.Expr)}
        parts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
        for node in ast.walk(tree):
            if isinstance(node, ast.JoinedStr):
                yield node.lineno, "".join(v.value if isinstance(v, ast.Constant) else "X" for v in node.values)
            elif (
                isinstance(node, ast.Constant)
                and isinstance(node.value, str)
                and " " in node.value
                and id(node) not in parts
            ):
                yield node.lineno, '"""' * (id(node) in docs) + node.value
    elif path.suffix == ".js":
        for i, line in enumerate(content.splitlines(), 1):
            yield from ((i, text) for text in re.findall(r"//.*|\"[^\"]* [^\"]*\"|`[^`]* [^`]*`", line))
    else:
        blank = lambda found: re.sub(r"[^\n]", " ", found[0])  # noqa: E731
        content = re.sub(r"(?ms)^ *```.*?^ *```|<!--.*?-->|\{[{%].*?[}%]\}|<[^>]*>", blank, content)
        yield 1, re.sub(r"`[^`\n]*`|\]\([^)]*\)|https?://\S+", blank, content)


def findings(path):
    """Line, words found, and suggestion of each finding in a file."""
    for line, text in texts(path):
        is_doc = text.startswith('"""')
        text = re.sub(r"`[^`]*`|(?m:^ +[\w, ]+ : )", lambda found: " " * len(found[0]), text.removeprefix('"""'))
        for pattern, instead in _WORDS.items():
            for found in pattern.finditer(re.sub(r"\n", " ", text)):
                yield line + text.count("\n", 0, found.start()), found[0], instead, pattern
        for pattern, instead in _FIRST.items():
            if is_doc and (found := pattern.match(text)):
                yield line, f'"""{found[0]} ...', instead, pattern


def files(places):
    for place in map(Path, places):
        found = [place] if place.is_file() else sorted(place.rglob("*"))
        yield from (one for one in found if one.suffix in (".py", ".md", ".html", ".js"))


def main(words):
    counts = Counter()
    places = [word for word in words if word != "--counts"]
    for path in files(places or [ROOT / name for name in CHECKED]):
        name = path.resolve().relative_to(ROOT).as_posix()
        for line, found, instead, pattern in sorted(findings(path), key=lambda one: one[0]):
            counts[pattern.pattern] += 1
            if "--counts" not in words:
                print(f"{name}:{line}: {' '.join(found.split())!r}; write: {instead}")
    if "--counts" in words:
        plain = {one.pattern: name for one, name in zip([*_WORDS, *_FIRST], [*EXPRESSIONS, *OPENINGS], strict=True)}
        print("\n".join(f"{n:6} {plain[pattern]}" for pattern, n in counts.most_common()))
    print(f"{counts.total()} findings")
    return bool(counts) and "--counts" not in words


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
