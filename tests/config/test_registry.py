"""Objects are built from dicts; invalid dicts are refused with the path."""

import importlib
import importlib.util
import inspect
import pkgutil
import subprocess
import sys
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Literal

import pytest

import mast_zenoh
from mast_zenoh.attacks import Attack
from mast_zenoh.config import registry
from mast_zenoh.config.registry import parse_scene
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenes import Intersection


class Animal(ABC):
    @abstractmethod
    def legs(self) -> int: ...


class Dog(Animal):
    def __init__(self, *, name: str = "rex", size: float = 1.0, trained: bool = False, friend: Animal | None = None):
        self.name, self.size, self.trained, self.friend = name, size, trained, friend

    def legs(self) -> int:
        return 4


class Bird(Animal):
    def __init__(self, *, colours: tuple[str, ...] = (), flies: Literal["high", "low"] = "high", feathers: int = 1):
        if feathers < 0:
            raise ValueError("feathers: found a negative number")
        self.colours, self.flies, self.feathers = colours, flies, feathers

    def legs(self) -> int:
        return 2


def build(spec: object) -> Animal:
    return registry.build(spec, Animal, "zoo")


def test_a_dict_names_its_class_and_parameters() -> None:
    bird = build(dict(type="Bird", colours=["red", "blue"], flies="low"))
    assert isinstance(bird, Bird)
    assert bird.colours == ("red", "blue")


def test_nested_dicts_are_built_by_annotation_and_integers_become_floats() -> None:
    dog = build(dict(type="Dog", size=2, friend=dict(type="Bird")))
    assert isinstance(dog, Dog)
    assert isinstance(dog.friend, Bird)
    assert dog.size == 2.0
    assert isinstance(dog.size, float)


@pytest.mark.parametrize(
    ("spec", "reason"),
    [
        ("Dog", r"zoo.*'Dog'.*dict\(type=…\)"),
        (dict(type="Dgo"), r"zoo\.type.*'Dgo'.*'Dog'"),
        (dict(), r"zoo.*given; known"),
        (dict(type="Dog", nam="x"), r"zoo\.nam.*parameter.*'name'"),
        (dict(type="Dog", name=3), r"zoo\.name.*3.*string"),
        (dict(type="Dog", size="big"), r"zoo\.size.*'big'.*number"),
        (dict(type="Dog", trained=1), r"zoo\.trained.*1.*False"),
        (dict(type="Bird", feathers=True), r"zoo\.feathers.*whole number"),
        (dict(type="Bird", feathers=-1), "zoo: Bird: feathers"),
        (dict(type="Bird", flies="hihg"), r"zoo\.flies.*'hihg'.*'high'"),
        (dict(type="Bird", colours="red"), r"zoo\.colours.*'red'.*list"),
        (dict(type="Bird", colours=[1]), r"zoo\.colours\[0\].*1.*string"),
        (dict(type="Dog", friend=dict(type="Bird", colour=1)), r"zoo\.friend\.colour.*mean 'colours'"),
    ],
)
def test_an_invalid_spec_is_refused_with_its_path(spec: object, reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason):
        build(spec)


ALGORITHMS = ("attacks", "faults", "fusion", "links", "metrics", "fusion.pipelines", "scenes", "sensing", "tracking")


@pytest.mark.parametrize("package", ALGORITHMS)
def test_importing_a_base_makes_all_shipped_subclasses_available(package: str) -> None:
    """In a new process, where modules not imported by the package are missing."""
    folder = Path(mast_zenoh.__file__).parent / package.replace(".", "/")
    defined = {}
    for info in pkgutil.iter_modules([str(folder)]):
        module = importlib.import_module(f"mast_zenoh.{package}.{info.name}")
        for cls in vars(module).values():
            ours = inspect.isclass(cls) and cls.__module__ == module.__name__ and inspect.isabstract(cls.__base__)
            if ours and cls.__base__.__module__.startswith(f"mast_zenoh.{package}."):
                defined[cls.__module__] = cls.__base__
    assert defined
    bases_by_place: dict[str, dict[str, str]] = {}
    for module, base in defined.items():
        public = hasattr(importlib.import_module(f"mast_zenoh.{package}"), base.__name__)
        bases_by_place.setdefault(f"mast_zenoh.{package}" if public else base.__module__, {})[module] = base.__name__
    for place, bases in bases_by_place.items():
        names = ", ".join(sorted(set(bases.values())))
        code = f"from {place} import {names}; import sys; print(*{set(bases)} - sys.modules.keys())"
        assert not subprocess.run([sys.executable, "-c", code], check=True, capture_output=True).stdout.strip()


class Unfinished(Animal):
    def leg(self) -> int:
        return 0


def test_a_class_that_lacks_a_method_is_refused_with_the_method() -> None:
    with pytest.raises(ConfigurationError, match=r"pet\.type: Unfinished.*define"):
        registry.build(dict(type="Unfinished"), Animal, "pet")


def test_a_dataclass_inherits_fields_whose_types_its_own_module_does_not_know(tmp_path: Path) -> None:
    """As that of a user who derives an attack from ours, and imports only that."""
    module = tmp_path / "mine.py"
    module.write_text(
        "from __future__ import annotations\nfrom dataclasses import dataclass\n"
        "from mast_zenoh.attacks import Attack, UncoordinatedAttack\n"
        "@dataclass(kw_only=True, eq=False)\nclass Louder(UncoordinatedAttack):\n    gain: float = 1.0\n"
    )
    spec = importlib.util.spec_from_file_location("mine", module)
    loaded = sys.modules["mine"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    attack = registry.build(
        {"type": loaded.Louder, "gain": 2, "selection": {"type": "UncoordinatedSelection"}}, Attack, "attack"
    )
    assert (attack.gain, type(attack.selection).__name__) == (2.0, "UncoordinatedSelection")


def test_a_class_derived_from_a_scene_does_not_take_its_short_name() -> None:
    class Slower(Intersection):
        pass

    assert parse_scene("intersection") == {"type": "Intersection"}
