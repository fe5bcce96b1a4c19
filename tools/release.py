"""What a release must pass, `make release-check`: archives, clean installs, extras, licences, the Dockerfile's steps.

It fetches libraries from the package index and works in a temporary folder; nothing of the project is imported here.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
import zipfile
from pathlib import Path
from time import monotonic

HOUSE = Path(__file__).resolve().parents[1]
BIN = Path(sys.executable).parent
PROJECT = tomllib.loads((HOUSE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
#: Starts a command in a network namespace whose loopback device is up, as `docker run --network none` has it.
LOOPBACK = (
    "import fcntl, os, socket, struct, sys; "
    "fcntl.ioctl(socket.socket(socket.AF_INET, socket.SOCK_DGRAM), 0x8914, struct.pack('16sh14x', b'lo', 0x41)); "
    "os.execv(sys.argv[1], sys.argv[1:])"
)
FORBIDDEN_LICENCES = "GPL;General Public;SSPL;Commons Clause;Proprietary;Non-Commercial;UNKNOWN"
#: pypatchworkpp is BSD-2-Clause: LICENSE of url-kaist/patchwork-plusplus.
LICENCE_NOT_IN_WHEEL = ["pypatchworkpp"]
GENERATED = re.compile(r"PKG-INFO|setup\.cfg|fidpipe\.egg-info/.*")
MISSING = {  # a command on a machine with the required libraries alone, and what its only line must advise
    "synth": (["synth", "streets"], "synth"),
    "ros": (["pair", "scan.bag", "scan.bag", "--out", "paired"], "ros"),
    "velodyne": (["pair", "scan.pcap", "scan.pcap", "--out", "paired"], "velodyne"),
    "las": (["run", "las", "--workers", "1"], "las"),
    "patchwork": (
        ["run", "dataset", "--set", "ground.method=patchwork", "--out", "patchwork"],
        "patchwork",
    ),
}


def main():
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        for step in (
            build,
            check_contents,
            try_wheel,
            try_extras,
            check_licences,
            try_sdist,
            try_dockerfile,
        ):
            began = monotonic()
            print(f"{step.__name__}: {step(folder)} ({monotonic() - began:.0f} s)", flush=True)


def build(folder):
    """Both archives; the wheel is built from the unpacked source archive."""
    run(BIN / "python", "-m", "build", "--no-isolation", "--outdir", folder / "dist", HOUSE)
    run(BIN / "twine", "check", "--strict", wheel(folder), sdist(folder))
    return ", ".join(
        f"{path.name} {path.stat().st_size:,} B" for path in (wheel(folder), sdist(folder))
    )


def check_contents(folder):
    """The source archive is what git has; the wheel is the package alone, each of its files in git."""
    kept = set(run("git", "-C", HOUSE, "ls-files").split()) - {".gitignore"}
    with tarfile.open(sdist(folder)) as archive:
        packed = {
            name.partition("/")[2]
            for name in archive.getnames()
            if archive.getmember(name).isfile()
        }
        archive.extractall(folder / "source", filter="data")
    packed = {name for name in packed if not GENERATED.fullmatch(name)}
    demand(
        packed == kept,
        f"source archive: too much {sorted(packed - kept)}, missing {sorted(kept - packed)}",
    )
    names = zipfile.ZipFile(wheel(folder)).namelist()
    own = {name.removeprefix("fidpipe/") for name in names if name.startswith("fidpipe/")}
    rooms = {name for name in kept if name.startswith(("pipeline/", "stages/", "schemas/"))} | {
        "__init__.py",
        "py.typed",
    }
    demand(
        own == rooms, f"wheel: too much {sorted(own - rooms)}, missing {sorted(rooms - own)}"
    )
    rest = [name for name in names if not re.match(r"fidpipe/|fidpipe-[^/]*\.dist-info/", name)]
    demand(not rest, f"wheel: {rest} would land beside other packages")
    return f"{len(packed)} files in the source archive, {len(own)} in the wheel"


def try_wheel(folder):
    """A run, its report and the hints for what is missing, with the required libraries alone."""
    bin_ = environment(folder / "clean")
    install(bin_, wheel(folder))
    place = folder / "place"
    place.mkdir(mode=0o755)
    scenes = f"import sys; sys.path.insert(0, {str(HOUSE / 'tests')!r}); import scenes; from pathlib import Path; "
    run(bin_ / "python", "-c", scenes + "scenes.write_dataset(Path('dataset'), 2)", cwd=place)
    fidpipe = bin_ / "fidpipe"
    demand(
        run(fidpipe, "--version").split()[1] == version(folder),
        "the command tells another version",
    )
    for words in (
        "check dataset",
        "run dataset",
        "report runs/dataset",
        "show runs/dataset",
        "gate runs/dataset --max cdc.mean=2",
    ):
        run(fidpipe, *words.split(), cwd=place)
    page = (place / "runs" / "dataset" / "report.html").stat().st_size
    demand(page > 100_000, f"the report has {page} bytes")
    for ending in ("bag", "pcap"):
        (place / f"scan.{ending}").write_bytes(b"\0" * 64)
    for side in ("real", "sim"):
        (place / "las" / side).mkdir(parents=True)
        (place / "las" / side / "scan.las").write_bytes(b"LASF")
    for extra, (words, advised) in MISSING.items():
        refused = subprocess.run(
            [fidpipe, *words], cwd=place, capture_output=True, text=True, check=False
        )
        lines = [
            line
            for line in refused.stderr.splitlines()
            if re.search(rf"pip install .fidpipe\[{advised}\]", line)
        ]
        demand(
            refused.returncode in {1, 3} and lines,
            f"extra {extra} missing: {refused.returncode}, {refused.stderr}",
        )
        demand("Traceback" not in refused.stderr, refused.stderr)
    n_packages = len(run(BIN / "uv", "pip", "freeze", "--python", bin_ / "python").splitlines())
    return f"run and report with {n_packages} packages; {len(MISSING)} hints"


def try_extras(folder):
    """Each extra resolves with the newest libraries, and all that users have together installs."""
    for extra in PROJECT["optional-dependencies"]:
        install(folder / "clean" / "bin", f"{wheel(folder)}[{extra}]", "--dry-run")
    install(folder / "clean" / "bin", f"{wheel(folder)}[all]")
    run(BIN / "uv", "pip", "check", "--python", folder / "clean" / "bin" / "python")
    run(
        folder / "clean" / "bin" / "fidpipe",
        "synth",
        "streets",
        "--pairs",
        "1",
        cwd=folder / "place",
    )
    return ", ".join(PROJECT["optional-dependencies"])


def check_licences(folder):
    """No library of any extra has a licence that binds the whole program, or an unknown one."""
    python = folder / "clean" / "bin" / "python"
    words = [BIN / "pip-licenses", "--python", python, "--from", "mixed"]
    words += ["--partial-match", "--fail-on", FORBIDDEN_LICENCES]
    words += ["--ignore-packages", *LICENCE_NOT_IN_WHEEL]
    run(*words)
    return "no forbidden licence"


def try_sdist(folder):
    """Installed from source; the tests in the archive run on it."""
    bin_ = environment(folder / "from-source")
    install(
        bin_,
        "--compile-bytecode",
        "--require-hashes",
        "--requirement",
        HOUSE / "requirements.lock",
    )
    install(bin_, "--no-deps", "--no-build-isolation", sdist(folder))
    [source] = (folder / "source").iterdir()
    told = run(
        bin_ / "pytest",
        "-q",
        "tests/schemas",
        "tests/stages/test_metrics.py",
        "tests/pipeline/test_cli.py",
        cwd=source,
    )
    return told.strip().splitlines()[-1]


def try_dockerfile(folder):
    """Its COPY and RUN steps in a folder instead of an image, then its command as another user, without network."""
    python = base_python()
    root = folder / "image"
    stages = re.split(
        r"^FROM ", (HOUSE / "Dockerfile").read_text(encoding="utf-8"), flags=re.MULTILINE
    )[1:]
    variables = {}
    work = root
    user = None
    entry = []
    n_steps = 0
    for stage in stages:
        work = root
        for step in stage.splitlines()[1:]:
            word, _, rest = step.partition(" ")
            rest = re.sub(r"(?<![\w.])/(opt|build|work)\b", rf"{root}/\1", rest)
            if word == "COPY" and not rest.startswith("--from"):
                copy_context(Path(rest.split()[1]))
            elif word == "WORKDIR":
                work = Path(rest)
                work.mkdir(parents=True, exist_ok=True)
            elif word == "RUN":
                path = root / "python"
                path.mkdir(exist_ok=True)
                if not (path / "python").exists():
                    (path / "python").symlink_to(python)
                run(
                    "/bin/sh",
                    "-c",
                    rest,
                    cwd=work,
                    env=os.environ | {"PATH": f"{path}:{os.environ['PATH']}"},
                )
            elif word == "ENV":
                variables |= [rest.split("=")]
            elif word == "USER":
                user = rest.split(":")
            elif word == "ENTRYPOINT":
                entry = [part.strip('[]" ') for part in rest.split(",")]
            else:
                demand(
                    word in {"", "#", "COPY", "CMD"},
                    f"Dockerfile: this check does not know {word}",
                )
            n_steps += bool(word)
    shutil.rmtree(root / "build")  # the second stage has the installed environment alone
    shutil.copytree(folder / "place" / "dataset", work / "dataset")
    if os.getuid() == 0:
        shutil.chown(work, int(user[0]), int(user[1]))
        as_user = [
            shutil.which("setpriv"),
            f"--reuid={user[0]}",
            f"--regid={user[1]}",
            "--clear-groups",
        ]
        entry = ["unshare", "--net", sys.executable, "-c", LOOPBACK, *as_user, *entry]
    told = run(*entry, "run", "dataset", cwd=work, env=variables | {"PATH": os.defpath})
    demand("Fix first" in told, told)
    return f"{n_steps} steps with {python}" + (
        f"; a run as user {user[0]} without network" if os.getuid() == 0 else ""
    )


def copy_context(target):
    """What `COPY .` would copy: the house without what .dockerignore names."""
    from pathspec import GitIgnoreSpec

    ignored = GitIgnoreSpec.from_lines(
        (HOUSE / ".dockerignore").read_text(encoding="utf-8").splitlines()
    )
    kept = set(run("git", "-C", HOUSE, "ls-files").split())
    for path in sorted(HOUSE.rglob("*")):
        name = str(path.relative_to(HOUSE))
        if path.is_file() and not ignored.match_file(name):
            demand(
                name in kept,
                f".dockerignore: {name} would be in the image, and is not under version control",
            )
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, target / name)


def base_python():
    """An interpreter that other users may run too; Debian's, where ours is in a home folder."""
    ours = Path(sys.executable).resolve()
    may_search = all(parent.stat().st_mode & 0o001 for parent in ours.parents)
    return ours if may_search or os.getuid() != 0 else Path("/usr/bin/python3").resolve()


def environment(folder):
    """The folder of commands of a new, empty environment."""
    run(BIN / "uv", "venv", "--quiet", "--python", sys.executable, folder)
    return folder / "bin"


def install(bin_, *words):
    run(BIN / "uv", "pip", "install", "--quiet", "--python", bin_ / "python", *words)


def wheel(folder):
    [found] = (folder / "dist").glob("*.whl")
    return found


def sdist(folder):
    [found] = (folder / "dist").glob("*.tar.gz")
    return found


def version(folder):
    return wheel(folder).name.split("-")[1]


def run(*words, **options):
    """Standard output of a command that must succeed."""
    done = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, check=False, **options
    )
    demand(
        done.returncode == 0,
        f"{shlex.join(map(str, words))}: code {done.returncode}\n{done.stdout}\n{done.stderr}",
    )
    return done.stdout


def demand(holds, complaint):
    if not holds:
        sys.exit(f"release check: {complaint}")


if __name__ == "__main__":
    main()
