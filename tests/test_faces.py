"""What each package offers: names that exist, told in one place, and none that one of its modules would hide."""

from importlib import import_module
from pathlib import Path

import pytest

import modaltouch

PACKAGE = Path(modaltouch.__file__).parent
FACES = sorted(file.parent.name for file in PACKAGE.glob("*/__init__.py") if "lazily" in file.read_text("utf-8"))


@pytest.mark.parametrize("room", FACES)
def test_a_face_offers_what_it_says(room):
    """Every name can be had; what is no name of it is refused with those that are."""
    face = import_module(f"modaltouch.{room}")
    assert len(face.__all__) == len(set(face.__all__)) > 0
    for name in face.__all__:
        assert getattr(face, name) is not None
    with pytest.raises(AttributeError, match=f"module 'modaltouch.{room}' has no attribute 'nothing'; it offers"):
        face.nothing  # noqa: B018


@pytest.mark.parametrize("room", FACES)
def test_a_face_is_small_enough_to_know_by_heart(room):
    """Twelve names; twice as many for protocol and stimulus, whose values every room speaks of."""
    assert len(import_module(f"modaltouch.{room}").__all__) <= (24 if room in ("protocol", "stimulus") else 12)


@pytest.mark.parametrize("room", FACES)
def test_no_module_hides_what_the_face_offers(room):
    """Importing a submodule binds its name in the face: a function of that name would be gone."""
    inside = {path.stem for path in (PACKAGE / room).iterdir() if path.suffix == ".py" or path.is_dir()}
    assert not inside & set(import_module(f"modaltouch.{room}").__all__)
