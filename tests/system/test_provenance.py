"""The version identifies the commit of the code and no other; without git there is still a version."""

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
    """Run git in a folder and return its output."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    environment |= {"GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_NOSYSTEM": "1"}
    command = ["git", "-c", "user.name=n", "-c", "user.email=e@example.org", *words]
    done = subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True, text=True)
    return done.stdout.strip()


def commit_all(folder):
    """Commit the contents of a folder and return the commit."""
    git(folder, "add", "--all")
    git(folder, "commit", "--quiet", "--message", "m")
    return git(folder, "rev-parse", "HEAD")


def reported(folder):
    """Return version and commit as reported by a fresh copy of the module."""
    copy = runpy.run_path(str(folder / "src" / "modaltouch" / "system" / "provenance.py"))
    return copy["version"](), copy["commit"]()


@pytest.fixture
def tree(tmp_path):
    """A folder with the layout of the checkout, outside any repository."""
    package = tmp_path / "src" / "modaltouch" / "system"
    package.mkdir(parents=True)
    shutil.copy(provenance.__file__, package)
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "modaltouch"\n')
    return tmp_path


@pytest.fixture
def checkout(tree):
    """The same folder as a repository with one commit."""
    git(tree, "init", "--quiet")
    commit_all(tree)
    return tree


def test_a_checkout_reports_its_commit_and_whether_it_is_modified(checkout):
    """Untracked files do not count as modifications."""
    commit = git(checkout, "rev-parse", "HEAD")
    (checkout / "notes.txt").write_text("")
    assert reported(checkout) == (f"{RELEASE}+g{commit[:12]}", commit)
    (checkout / "pyproject.toml").write_text('[project]\nname = "modaltouch"\n\n')
    assert reported(checkout) == (f"{RELEASE}+g{commit[:12]}.dirty", f"{commit}+")


def test_the_commit_with_the_release_tag_is_the_release(checkout):
    """Later commits, modified trees and other tags are not the release."""
    git(checkout, "tag", "v9.9.9")
    first = git(checkout, "rev-parse", "HEAD")
    assert reported(checkout)[0] == f"{RELEASE}+g{first[:12]}"
    git(checkout, "tag", f"v{RELEASE}")
    assert reported(checkout) == (RELEASE, first)
    (checkout / "more.txt").write_text("")
    git(checkout, "add", "more.txt")
    assert reported(checkout) == (f"{RELEASE}+g{first[:12]}.dirty", f"{first}+")
    second = commit_all(checkout)
    assert reported(checkout) == (f"{RELEASE}+g{second[:12]}", second)


def test_a_linked_worktree_is_a_checkout(checkout, tmp_path_factory):
    """There `.git` is a file."""
    linked = tmp_path_factory.mktemp("linked") / "tree"
    git(checkout, "worktree", "add", "--quiet", "--detach", str(linked))
    assert reported(linked) == reported(checkout)
    assert reported(linked)[1]


def test_the_commit_of_another_repository_is_not_reported(tree):
    """Neither a copy of the source below a repository nor one in a project of the same layout takes its commit."""
    git(tree.parent, "init", "--quiet")
    (tree.parent / "theirs.txt").write_text("")
    commit_all(tree.parent)
    assert reported(tree) == (RELEASE, "")
    git(tree, "init", "--quiet")
    (tree / "pyproject.toml").write_text('[project]\nname = "theirs"\n')
    commit_all(tree)
    assert reported(tree) == (RELEASE, "")


def test_the_git_variables_of_a_hook_are_ignored(checkout, tmp_path_factory, monkeypatch):
    """Git sets GIT_DIR and GIT_INDEX_FILE for every program that a hook runs."""
    other = tmp_path_factory.mktemp("other")
    git(other, "init", "--quiet")
    (other / "file.txt").write_text("")
    commit_all(other)
    before = reported(checkout)
    monkeypatch.setenv("GIT_DIR", str(other / ".git"))
    monkeypatch.setenv("GIT_INDEX_FILE", ".git/index")
    assert reported(checkout) == before


@pytest.mark.parametrize("broken", ["no git", "git fails", "no commit"])
def test_without_git_the_version_is_the_release(tree, monkeypatch, broken):
    """A missing git, a broken repository and one without a commit are not errors."""
    git(tree, "init", "--quiet")
    if broken != "no commit":
        commit_all(tree)
    if broken == "no git":
        monkeypatch.setenv("PATH", str(tree))
    if broken == "git fails":
        (tree / ".git" / "HEAD").write_text("nonsense")
    assert reported(tree) == (RELEASE, "")


def test_the_commit_of_the_build_takes_precedence_over_git(checkout):
    """An unpacked source distribution may lie inside a repository."""
    (checkout / "src" / "modaltouch" / "build.txt").write_text("9.8.7+gabc abcdef+\n")
    assert reported(checkout) == ("9.8.7+gabc", "abcdef+")


def test_the_version_is_the_same_everywhere():
    """The package attribute and the versions of a record agree."""
    import modaltouch

    assert modaltouch.__version__ == provenance.version() == provenance.versions()["modaltouch"]
    assert provenance.version().startswith(RELEASE)


def test_the_changelog_begins_with_the_release():
    """Unreleased changes come above it, without a number."""
    text = (Path(__file__).parents[2] / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.findall(r"^## \[(.*?)\]", text, flags=re.MULTILINE)[:2] == ["Unreleased", RELEASE]
