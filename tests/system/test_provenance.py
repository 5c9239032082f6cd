"""The version names the commit that the code is of, and no other; without git there is still a version."""

import os
import re
import runpy
import shutil
import subprocess
from pathlib import Path

import pytest

from modaltouch.system import provenance

RELEASE = provenance.RELEASE


def git(folder, *words):
    """Run git in a folder and return what it says."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    environment |= {"GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_NOSYSTEM": "1"}
    command = ["git", "-c", "user.name=n", "-c", "user.email=e@example.org", *words]
    done = subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True, text=True)
    return done.stdout.strip()


def commit_all(folder):
    """Commit what a folder holds and return the commit."""
    git(folder, "add", "--all")
    git(folder, "commit", "--quiet", "--message", "m")
    return git(folder, "rev-parse", "HEAD")


def told(folder):
    """Return version and commit as a copy of the module tells them, anew."""
    copy = runpy.run_path(str(folder / "src" / "modaltouch" / "system" / "provenance.py"))
    return copy["version"](), copy["commit"]()


@pytest.fixture
def tree(tmp_path):
    """A folder laid out as the checkout is, in no repository."""
    package = tmp_path / "src" / "modaltouch" / "system"
    package.mkdir(parents=True)
    shutil.copy(provenance.__file__, package)
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "modaltouch"\n')
    return tmp_path


@pytest.fixture
def checkout(tree):
    """The same as a repository of one commit."""
    git(tree, "init", "--quiet")
    commit_all(tree)
    return tree


def test_a_checkout_names_its_commit_and_whether_it_is_changed(checkout):
    """What is not tracked changes nothing."""
    commit = git(checkout, "rev-parse", "HEAD")
    (checkout / "notes.txt").write_text("")
    assert told(checkout) == (f"{RELEASE}+g{commit[:12]}", commit)
    (checkout / "pyproject.toml").write_text('[project]\nname = "modaltouch"\n\n')
    assert told(checkout) == (f"{RELEASE}+g{commit[:12]}.dirty", f"{commit}+")


def test_the_tag_of_the_release_makes_its_commit_the_release(checkout):
    """Neither what comes after it, nor what is changed at it, nor another tag does."""
    git(checkout, "tag", "v9.9.9")
    first = git(checkout, "rev-parse", "HEAD")
    assert told(checkout)[0] == f"{RELEASE}+g{first[:12]}"
    git(checkout, "tag", f"v{RELEASE}")
    assert told(checkout) == (RELEASE, first)
    (checkout / "more.txt").write_text("")
    git(checkout, "add", "more.txt")
    assert told(checkout) == (f"{RELEASE}+g{first[:12]}.dirty", f"{first}+")
    second = commit_all(checkout)
    assert told(checkout) == (f"{RELEASE}+g{second[:12]}", second)


def test_a_linked_work_tree_is_a_checkout_too(checkout, tmp_path_factory):
    """Its `.git` is a file."""
    linked = tmp_path_factory.mktemp("linked") / "tree"
    git(checkout, "worktree", "add", "--quiet", "--detach", str(linked))
    assert told(linked) == told(checkout)
    assert told(linked)[1]


def test_the_repository_of_somebody_else_is_not_named(tree):
    """The package copied into a project of the same layout, and a copy of the source below a repository."""
    git(tree.parent, "init", "--quiet")
    (tree.parent / "theirs.txt").write_text("")
    commit_all(tree.parent)
    assert told(tree) == (RELEASE, "")
    git(tree, "init", "--quiet")
    (tree / "pyproject.toml").write_text('[project]\nname = "theirs"\n')
    commit_all(tree)
    assert told(tree) == (RELEASE, "")


def test_a_hook_of_another_repository_does_not_mislead(checkout, tmp_path_factory, monkeypatch):
    """Git sets these for whatever it runs in a hook."""
    other = tmp_path_factory.mktemp("other")
    git(other, "init", "--quiet")
    (other / "file.txt").write_text("")
    commit_all(other)
    before = told(checkout)
    monkeypatch.setenv("GIT_DIR", str(other / ".git"))
    monkeypatch.setenv("GIT_INDEX_FILE", ".git/index")
    assert told(checkout) == before


@pytest.mark.parametrize("broken", ["no git", "git fails", "no commit"])
def test_without_an_answer_of_git_the_version_is_the_release(tree, monkeypatch, broken):
    """Git absent, a repository that it refuses, and one without a commit: never an error."""
    git(tree, "init", "--quiet")
    if broken != "no commit":
        commit_all(tree)
    if broken == "no git":
        monkeypatch.setenv("PATH", str(tree))
    if broken == "git fails":
        (tree / ".git" / "HEAD").write_text("nonsense")
    assert told(tree) == (RELEASE, "")


def test_what_the_build_wrote_down_comes_before_what_git_says(checkout):
    """An unpacked source distribution may lie in a repository."""
    (checkout / "src" / "modaltouch" / "build.txt").write_text("9.8.7+gabc abcdef+\n")
    assert told(checkout) == ("9.8.7+gabc", "abcdef+")


def test_the_package_tells_the_same_version_everywhere():
    """The attribute of the package, and the versions of a record."""
    import modaltouch

    assert modaltouch.__version__ == provenance.version() == provenance.versions()["modaltouch"]
    assert provenance.version().startswith(RELEASE)


def test_the_changelog_begins_with_the_release():
    """What is in the making stands above it, without a number."""
    text = (Path(__file__).parents[2] / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.findall(r"^## \[(.*?)\]", text, flags=re.MULTILINE)[:2] == ["Unreleased", RELEASE]
