"""The public names of each package: they exist, are listed once, and are not hidden by a submodule."""

from importlib import import_module
from pathlib import Path

import pytest

import modaltouch

PACKAGE = Path(modaltouch.__file__).parent
FACES = sorted(file.parent.name for file in PACKAGE.glob("*/__init__.py") if "lazily" in file.read_text("utf-8"))


@pytest.mark.parametrize("room", FACES)
def test_a_package_provides_every_name_it_lists(room):
    """Every name in `__all__` can be imported; the error for any other name lists those that exist."""
    face = import_module(f"modaltouch.{room}")
    assert len(face.__all__) == len(set(face.__all__)) > 0
    for name in face.__all__:
        assert getattr(face, name) is not None
    with pytest.raises(AttributeError, match=f"module 'modaltouch.{room}' has no attribute 'nothing'; it offers"):
        face.nothing  # noqa: B018


@pytest.mark.parametrize("room", FACES)
def test_a_package_has_few_public_names(room):
    """At most twelve names; 24 for protocol and stimulus, whose values all packages use."""
    assert len(import_module(f"modaltouch.{room}").__all__) <= (24 if room in ("protocol", "stimulus") else 12)


@pytest.mark.parametrize("room", FACES)
def test_no_submodule_hides_a_public_name(room):
    """Importing a submodule binds its name in the package and would hide a function of that name."""
    inside = {path.stem for path in (PACKAGE / room).iterdir() if path.suffix == ".py" or path.is_dir()}
    assert not inside & set(import_module(f"modaltouch.{room}").__all__)
