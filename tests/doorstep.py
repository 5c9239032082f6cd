"""Installation on other machines: bare Debian roots, clone and wheel, as root and as a user.

``python3 tests/doorstep.py --out results/benchmarks/doorstep.json``, as root, with debootstrap on the path. Python 3.11
or 3.12 is the distribution's where it has one; otherwise ``--python FOLDER`` is copied into the root.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build" / "doorstep"
PASSED_ON = re.compile(r"(PIP|UV|SSL|CURL|REQUESTS)_|GIT_SSL|https?_proxy|no_proxy", re.IGNORECASE)
"""Variables that tell how this machine reaches the package registries; a new one reaches them the same way."""

LIMIT = 900.0
"""Beyond this a command counts as hanging [s]."""

CLONE = """
git clone --quiet {source} {home}/modaltouch && cd {home}/modaltouch
make demo
ls results/simulated/demo/derivatives/*/analysis/report.html
"""

AGAIN = "cd {home}/modaltouch && make demo"

WHEEL = """
cd {home}
{python} -m venv env
env/bin/pip install --quiet --no-cache-dir {wheel}
export PATH=$PWD/env/bin:$PATH
modaltouch --version
modaltouch doctor
modaltouch new study
cd study
modaltouch check differentiated_stimulation
modaltouch check protocols/differentiated_stimulation.yaml
modaltouch simulate protocols/differentiated_stimulation.yaml -n 2
modaltouch analyse results/simulated/differentiated_stimulation
modaltouch verify results/simulated/differentiated_stimulation/sub-sim01/ses-1
modaltouch demo
"""


@dataclass
class Trial:
    """One way to install, and its result."""

    suite: str
    user: str
    way: str
    python: str
    load: int
    expected: int = 0
    status: int | None = None
    seconds: float = 0.0
    n_tracebacks: int = 0
    hung: bool = False
    last_lines: list[str] = field(default_factory=list)

    @property
    def holds(self) -> bool:
        """Whether it ended with the expected status and showed no traceback."""
        as_it_should = self.status == 0 if self.expected == 0 else self.status not in (0, None)
        return as_it_should and not self.n_tracebacks and not self.hung


class Debian:
    """A bare root of a distribution, made once and kept; each way to install is tried in a copy."""

    def __init__(self, suite: str, python: Path | None) -> None:
        self.suite = suite
        self._python = python
        self._bare = BUILD / suite
        self.root = BUILD / f"{suite}-tried"

    def renew(self) -> None:
        """Create a bare copy with a user and with this machine's access to the registries."""
        if not (self._bare / "usr" / "bin" / "git").exists():
            shutil.rmtree(self._bare, ignore_errors=True)
            included = "--include=python3,make,git,ca-certificates"
            subprocess.run(["debootstrap", "--variant=minbase", included, self.suite, self._bare], check=True)
        shutil.rmtree(self.root, ignore_errors=True)
        subprocess.run(["cp", "-a", "--reflink=auto", self._bare, self.root], check=True)
        for name in ("/etc/resolv.conf", os.environ.get("SSL_CERT_FILE", "")):
            if name and Path(name).is_file():
                place = self.root / name.lstrip("/")
                place.parent.mkdir(parents=True, exist_ok=True)
                place.unlink(missing_ok=True)
                shutil.copyfile(name, place)
        if self._python is not None:
            # At the path that it was built for, readable by everybody.
            shutil.copytree(self._python, self.root / str(self._python).lstrip("/"), symlinks=True)
            script = f"chmod a+rx /root; echo {self._python}/lib > /etc/ld.so.conf.d/python.conf; ldconfig"
            self.run(f"{script}; ln -s {self._python}/bin/python3.1? /usr/local/bin", "root", LIMIT)
        self.run("useradd --create-home ordinary && git config --system --add safe.directory '*'", "root", LIMIT)

    def run(self, script: str, user: str, limit: float) -> tuple[int | None, str]:
        """Return status and output of a shell script inside, in a separate PID namespace; status None if it hangs."""
        home = "/root" if user == "root" else f"/home/{user}"
        variables = {name: value for name, value in os.environ.items() if PASSED_ON.match(name)}
        variables |= {"HOME": home, "USER": user, "TERM": "dumb"}
        variables["PATH"] = "/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin"
        words = " ".join(f"{name}={shlex.quote(value)}" for name, value in variables.items())
        inside = (
            f"chroot --userspec={user}:{user} {self.root} /usr/bin/env -i {words} /bin/sh -ec {shlex.quote(script)}"
        )
        mounts = [f"mount -t proc proc {self.root}/proc", f"mount -t tmpfs tmpfs {self.root}/tmp"]
        mounts += [f"mount --rbind /dev {self.root}/dev", f"mkdir -p {self.root}/source {self.root}/wheel"]
        mounts += [f"mount --bind {ROOT} {self.root}/source", f"mount --bind {BUILD}/wheel {self.root}/wheel"]
        # When the first shell of this namespace ends, everything in it ends.
        command = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-ec", "; ".join([*mounts, inside])]
        with subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        ) as it:
            try:
                said, _ = it.communicate(timeout=limit)
            except subprocess.TimeoutExpired:
                it.kill()
                said, _ = it.communicate()
                return None, said.decode(errors="replace")
        return it.returncode, said.decode(errors="replace")


@contextmanager
def busy(n_loops: int) -> Iterator[None]:
    """Keep this many loops running in the background."""
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(n_loops)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def attempt(debian: Debian, trial: Trial, script: str, logs: Path) -> Trial:
    """Try one way to install, and record the result."""
    print(f"{trial.suite} {trial.user:9} {trial.way} ({trial.load} busy loops) ...", end=" ", flush=True)
    began = time.monotonic()
    with busy(trial.load):
        trial.status, said = debian.run(script, trial.user, LIMIT)
    trial.seconds = round(time.monotonic() - began, 1)
    trial.hung = trial.status is None
    trial.n_tracebacks = said.count("Traceback (most recent call last)")
    trial.last_lines = said.splitlines()[-3:]
    logs.mkdir(parents=True, exist_ok=True)
    (logs / f"{trial.suite}_{trial.user}_{trial.way}_{trial.load}.log".replace(" ", "_")).write_text(said)
    print(f"{'holds' if trial.holds else 'FAILS'}, status {trial.status}, {trial.seconds} s", flush=True)
    return trial


def try_all(suite: str, python: Path | None) -> Iterator[Trial]:
    """Yield every way to install on one distribution."""
    debian = Debian(suite, python)
    debian.renew()
    name = f"{python}/bin/python3" if python is not None else "python3"
    _, version = debian.run(f"{name} -c 'import platform; print(platform.python_version())'", "root", LIMIT)
    wheel = "/wheel/" + next((BUILD / "wheel").glob("*.whl")).name
    ways = [
        # Only root may install what the window needs: an error says so.
        ("ordinary", "clone, nothing installed", CLONE, 0, 2),
        ("root", "clone", CLONE, 0, 0),
        ("ordinary", "clone", "rm -rf {home}/modaltouch" + CLONE, 0, 0),
        ("ordinary", "demo again", AGAIN, 4, 0),
        ("root", "wheel", WHEEL, 0, 0),
        ("ordinary", "wheel", WHEEL, 4, 0),
    ]
    for user, way, script, load, expected in ways:
        home = "/root" if user == "root" else f"/home/{user}"
        filled = script.format(home=home, source="/source", python=name, wheel=wheel)
        trial = Trial(suite, user, way, version.strip(), load, expected)
        yield attempt(debian, trial, filled, BUILD / "logs")


def build_wheel() -> None:
    """Build the wheel that a user would install."""
    shutil.rmtree(BUILD / "wheel", ignore_errors=True)
    python = ROOT / ".venv" / "bin" / "python"
    subprocess.run([python, "-m", "hatchling", "build", "-t", "wheel", "-d", BUILD / "wheel"], cwd=ROOT, check=True)


def main() -> int:
    """Try every way to install and write the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--suites", nargs="+", default=["bookworm", "trixie"])
    parser.add_argument("--python", type=Path, default=None, help="folder of a Python 3.11 or 3.12, for suites without")
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    BUILD.mkdir(parents=True, exist_ok=True)
    build_wheel()
    trials = []
    for suite in options.suites:
        trials += try_all(suite, None if suite == "bookworm" else options.python)
    text = json.dumps(
        {"n": len(trials), "trials": [{**asdict(each), "holds": each.holds} for each in trials]}, indent=2
    )
    if options.out is not None:
        options.out.write_text(text + "\n", encoding="utf-8")
    for each in trials:
        if not each.holds:
            print(f"{each.suite} {each.user} {each.way}:", *each.last_lines, sep="\n  ")
    return 0 if all(each.holds for each in trials) else 1


if __name__ == "__main__":
    sys.exit(main())
