"""What a lab must be able to trust: no code in data, no shell, requirements locked by hashes."""

import ast
import re
import socket
from pathlib import Path

import pytest

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.simulator import Simulator

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "src").rglob("*.py"))
OWN_PIPE = {"watchdog_client.py", "watchdog_process.py"}
"""The two ends of the pipe between a session and the watchdog that it started; nobody else can write to it."""


def calls(path):
    """Return (name, keywords) of every call in a module."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            yield name, {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}


def test_no_data_is_executed():
    """The source has no eval, exec, object-building YAML or shell, and pickles only between its own processes."""
    for path in SOURCES:
        text = path.read_text(encoding="utf-8")
        pickles = re.search(r"^\s*(import|from) (pickle|shelve|dill|marshal)\b", text, flags=re.MULTILINE)
        assert not pickles or path.name in OWN_PIPE, path
        for name, keywords in calls(path):
            assert name not in ("eval", "exec", "os.system", "os.popen"), f"{path}: {name}"
            assert keywords.get("shell", "False") == "False", f"{path}: a shell"
            if name.startswith("yaml.") and re.search(r"^import yaml$", text, flags=re.MULTILINE):
                assert name == "yaml.parse", f"{path}: {name} may build objects"
            assert "unsafe" not in keywords.get("typ", ""), f"{path}: YAML that builds objects"
            if name == "np.load":
                assert keywords.get("allow_pickle") == "False", f"{path}: np.load may unpickle"


def test_every_page_escapes_what_it_shows():
    """HTML templates come from environments with autoescape."""
    made = [(path, keywords) for path in SOURCES for name, keywords in calls(path) if name.endswith("Environment")]
    assert made
    for path, keywords in made:
        assert keywords.get("autoescape") == "True", path


@pytest.mark.parametrize(("lock", "n_packages"), [("requirements.lock", 100), ("docs/requirements.lock", 25)])
def test_every_requirement_is_locked_by_its_hash(lock, n_packages):
    """A lock file gives each package a version and at least one SHA-256, and no URL."""
    text = (ROOT / lock).read_text(encoding="utf-8")
    packages = re.findall(r"^([a-z0-9][\w.\-\[\]]*)==", text, flags=re.MULTILINE)
    assert len(packages) > n_packages
    blocks = re.split(r"^(?=[a-z0-9][\w.\-\[\]]*==)", text, flags=re.MULTILINE)[1:]
    assert all("--hash=sha256:" in block for block in blocks)
    assert "://" not in text


def test_the_twin_listens_on_the_loopback_address_only():
    """Its port accepts connections on 127.0.0.1 and on no other address of this machine."""
    apparatus = Apparatus.read(ROOT / "protocols" / "apparatus" / "beam_100x6x2.yaml")
    with Simulator(apparatus) as simulator:
        port = int(re.search(r",(\d+)::", simulator.address).group(1))
        socket.create_connection(("127.0.0.1", port), timeout=5).close()
        others = {each[4][0] for each in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)} - {"127.0.0.1"}
        for address in others:
            with pytest.raises(OSError, match="refused|unreachable|timed out"):
                socket.create_connection((address, port), timeout=2)
