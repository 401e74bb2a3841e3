"""Content that does not fit a dataclass is named with its place, and in a file with its line."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.errors import InputError
from fopid_core.study.experiments.yaml_schema import Keys, SchemaError, Tagged, bind, plain, read_yaml


@dataclass(frozen=True)
class Circle(Tagged):
    radius: float


@dataclass(frozen=True)
class Box(Tagged):
    width: float
    height: float = 1.0

    def __post_init__(self) -> None:
        if self.width < 0:
            raise InputError(f"width = {self.width}; allowed: 0 or more")


@dataclass(frozen=True)
class Sheet:
    name: str
    count: int = 1
    ready: bool = False
    shape: float | Circle | Box | None = None
    corners: tuple[tuple[float, float], ...] = ()
    options: Annotated[Mapping[str, Any], Keys({"speed": float, "label": str})] = field(default_factory=dict)


TEXT = """\
name: a
count: 2
shape:
  box:
    width: 3
    height: 1e-3
corners: [[0, 1], [2, 3.5]]
options:
  speed: inf
"""


def read(tmp_path: Path, text: str) -> Sheet:
    path = tmp_path / "sheet.yaml"
    path.write_text(text, encoding="utf-8")
    return read_yaml(path, Sheet, "sheet")


def test_a_file_becomes_the_dataclass(tmp_path: Path) -> None:
    expected = Sheet("a", 2, False, Box(3.0, 0.001), ((0.0, 1.0), (2.0, 3.5)), {"speed": float("inf")})
    assert read(tmp_path, TEXT) == expected


@pytest.mark.parametrize(
    ("old", "new", "line", "named"),
    [
        ("count: 2", "count: 2.5", 2, "count = 2.5; allowed: a whole number"),
        ("count: 2", "count: true", 2, "allowed: a whole number"),
        ("count: 2", "cuont: 2", 2, "did you mean 'count'?"),
        ("name: a", "other: a", 1, "no key 'other'"),
        ("  box:", "  bax:", 4, "shape.bax: there is no key 'bax'; did you mean 'box'?"),
        ("width: 3", "width: -3", 5, "shape.box.width: width = -3.0; allowed: 0 or more"),
        ("width: 3", "width: wide", 5, "width = 'wide'; allowed: a number"),
        ("width: 3", f"width: 1{400 * '0'}", 5, "allowed: a number"),
        (
            "shape:\n  box:\n    width: 3\n    height: 1e-3",
            "shape: [3]",
            3,
            "shape = [3]; allowed: a number, or one of circle, box",
        ),
        ("width: 3", "width: 3\n    width: 4", 6, "'width' stands there twice"),
        ("    width: 3\n", "", 4, "the key 'width' is missing"),
        ("[2, 3.5]", "[2]", 7, "corners[1]: corners = [2]; allowed: a list of 2"),
        ("[[0, 1], [2, 3.5]]", "none", 7, "allowed: a list"),
        ("  speed: inf", "  speeed: inf", 9, "options.speeed: there is no key 'speeed'; did you mean 'speed'?"),
        ("  speed: inf", "  1: inf", 9, "key 1; allowed: a name"),
        ("options:\n  speed: inf", "options: 3", 8, "options = 3; allowed: keys with values"),
    ],
)
def test_what_does_not_fit_is_named_with_its_line(tmp_path: Path, old: str, new: str, line: int, named: str) -> None:
    assert old in TEXT
    with pytest.raises(InputError) as error:
        read(tmp_path, TEXT.replace(old, new, 1))
    message = str(error.value)
    assert f"sheet.yaml', line {line}: " in message
    assert named in message
    assert "\n" not in message


def test_a_text_that_is_no_yaml_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"sheet\.yaml' cannot be read: .*line 1") as error:
        read(tmp_path, "a: [1")
    assert "\n" not in str(error.value)


def test_anchors_and_merges_are_read(tmp_path: Path) -> None:
    text = "name: a\nshape: &s {box: {width: 2}}\noptions: {<<: {speed: 1}, label: x}\n"
    assert read(tmp_path, text).options == {"speed": 1.0, "label": "x"}


def test_a_list_that_contains_itself_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read(tmp_path, "corners: &a [*a]")


finite = st.floats(allow_nan=False, allow_infinity=False)
shapes = st.none() | finite | st.builds(Circle, finite) | st.builds(Box, st.floats(0, 1e300), finite)
sheets = st.builds(Sheet, st.text(min_size=1), st.integers(), st.booleans(), shapes,
                   st.lists(st.tuples(finite, finite)).map(tuple))  # fmt: skip


@settings(derandomize=True, deadline=None, max_examples=150)
@given(sheets)
def test_plain_data_reads_back_the_same(sheet: Sheet) -> None:
    assert bind(Sheet, json.loads(json.dumps(plain(sheet)))) == sheet


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | finite | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["name", "count", "shape", "box", "width", "corners", "x"]), inner, max_size=4
        )
    ),
    max_leaves=12,
)


@settings(derandomize=True, deadline=None, max_examples=300)
@given(json_values)
def test_any_content_is_taken_or_refused_in_one_line(content: Any) -> None:
    reason = ""
    try:
        bind(Sheet, yaml.safe_load(yaml.safe_dump(content)))
    except SchemaError as error:
        reason = str(error)
    assert "\n" not in reason
