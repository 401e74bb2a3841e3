"""YAML files whose keys and values are those of dataclasses; what does not fit is named with its line.

The dataclasses are the schema: ``bind`` reads their annotations, their ``__post_init__`` checks the values. Own,
because msgspec and pydantic tell neither the line nor the nearest name, and see no key that stands twice.
"""

from __future__ import annotations

import difflib
import re
import types
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

import yaml

from fopid_core import safe_yaml
from fopid_core.errors import InputError

Place = tuple[str | int, ...]
"""Where something stands in a file: keys, and positions in lists."""

T = TypeVar("T")

# Written in C, where PyYAML has them: a recorded signal may have 100,000 points.
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
_MERGE = "tag:yaml.org,2002:merge"
_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


class SchemaError(InputError):
    """Content that does not fit.

    Attributes
    ----------
    place : tuple of str and int
        Where it stands.
    reason : str
    """

    def __init__(self, place: Place, reason: str) -> None:
        self.place, self.reason = place, reason
        super().__init__(f"{place_text(place)}: {reason}" if place else reason)


def place_text(place: Place) -> str:
    """A place as people write it.

    Examples
    --------
    >>> place_text(("phases", 0, "setpoint"))
    'phases[0].setpoint'
    """
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in place).removeprefix(".")


class Tagged:
    """One of several kinds of value: written as a mapping whose only key is the class's name in small letters."""


@dataclass(frozen=True)
class Keys:
    """In ``Annotated[Mapping[str, Any], Keys(...)]``: the keys allowed, and what their values are."""

    kinds: Mapping[str, Any]


def read_yaml(path: Path, kind: type[T], what: str, then: Callable[[T], T] = lambda found: found) -> T:
    """An instance of a dataclass from a file.

    Parameters
    ----------
    path : Path
    kind : type
        The dataclass.
    what : str
        What messages call the file.
    then : callable, optional
        What else is done with what was read, while the lines are known.

    Raises
    ------
    InputError
        Naming the file, the line and the key that cannot be used.
    """
    lines: dict[Place, int] = {}
    try:
        text = safe_yaml.read_text(path)
        safe_yaml.check(text)
        content = _content(text, lines)
        return then(bind(kind, content))
    except SchemaError as error:
        known = next(error.place[:n] for n in range(len(error.place), -1, -1) if error.place[:n] in lines)
        raise InputError(f"{what} {str(path)!r}, line {lines[known]}: {error}") from None
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise InputError(f"{what} {str(path)!r} cannot be read: {' '.join(str(error).split())}") from None


def check_name(name: str) -> None:
    """Raise InputError for a name that files cannot be called by."""
    if not name.strip() or "/" in name or not name.isprintable():
        raise InputError(f"name = {name!r}; allowed: a text in one line, without '/'")


def _content(text: str, lines: dict[Place, int]) -> Any:
    """The plain data of a YAML text; ``lines`` is filled with the line of each place."""
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        lines[()] = 1
        return None if node is None else _value(loader, node, (), lines)
    finally:
        loader.dispose()


def _value(loader: yaml.SafeLoader, node: yaml.Node, place: Place, lines: dict[Place, int]) -> Any:
    lines.setdefault(place, node.start_mark.line + 1)
    if isinstance(node, yaml.SequenceNode):
        return [_value(loader, item, (*place, i), lines) for i, item in enumerate(node.value)]
    if not isinstance(node, yaml.MappingNode):
        return loader.construct_object(node, deep=True)
    _check_keys(loader, node, place, lines)
    loader.flatten_mapping(node)
    content = {}
    for key_node, value_node in node.value:
        key = loader.construct_object(key_node, deep=True)
        lines[(*place, key)] = key_node.start_mark.line + 1
        content[key] = _value(loader, value_node, (*place, key), lines)
    return content


def _check_keys(loader: yaml.SafeLoader, node: yaml.MappingNode, place: Place, lines: dict[Place, int]) -> None:
    """Texts, and none of them twice: YAML itself would silently take the last."""
    seen = set()
    for key_node, _ in node.value:
        if key_node.tag == _MERGE:
            continue
        key = loader.construct_object(key_node, deep=True)
        lines[(*place, str(key))] = key_node.start_mark.line + 1
        if not isinstance(key, str):
            raise SchemaError((*place, str(key)), f"key {key!r}; allowed: a name")
        if key in seen:
            raise SchemaError((*place, key), f"the key {key!r} stands there twice; allowed: once")
        seen.add(key)


def bind(kind: Any, content: Any, place: Place = ()) -> Any:
    """Plain data as a value of an annotated kind.

    Parameters
    ----------
    kind : type or annotation
        A dataclass, bool, int, float, str, ``X | None``, tuples, mappings from str, and unions with ``Tagged`` classes.
    content : object
        As YAML gives it. A number may be a text that reads as one: YAML takes ``1e-3`` and ``inf`` for texts.
    place : tuple
        Where the content stands, for messages.

    Raises
    ------
    SchemaError
        Naming the place, what stands there and what is allowed.

    Examples
    --------
    >>> bind(tuple[float, ...], [1, "1e-3"])
    (1.0, 0.001)
    """
    origin = get_origin(kind)
    if origin is Annotated:
        return _bind_keys(kind.__metadata__[0].kinds, content, place)
    if origin in (Union, types.UnionType):
        return _bind_union(get_args(kind), content, place)
    if origin is tuple:
        return _bind_tuple(get_args(kind), content, place)
    if origin is not None and issubclass(origin, Mapping):
        checked = _mapping(content, place)
        return {key: bind(get_args(kind)[1], value, (*place, key)) for key, value in checked.items()}
    if is_dataclass(kind):
        return _bind_dataclass(kind, content, place)
    return content if kind is Any else _bind_scalar(kind, content, place)


def _bind_scalar(kind: type, content: Any, place: Place) -> Any:
    if kind is float and isinstance(content, (int, float, str)) and not isinstance(content, bool):
        try:
            return float(content)
        except (ValueError, OverflowError):
            pass
    elif type(content) is kind:
        return content
    raise SchemaError(place, f"{_name(place)} = {content!r}; allowed: {_WORDS.get(kind, kind.__name__)}")


def _name(place: Place) -> str:
    return next((step for step in reversed(place) if isinstance(step, str)), "content")


def _bind_tuple(kinds: tuple[Any, ...], content: Any, place: Place) -> tuple[Any, ...]:
    if not isinstance(content, (list, tuple)):
        raise SchemaError(place, f"{_name(place)} = {content!r}; allowed: a list")
    if kinds[-1] is Ellipsis:
        return tuple(bind(kinds[0], item, (*place, i)) for i, item in enumerate(content))
    if len(content) != len(kinds):
        raise SchemaError(place, f"{_name(place)} = {content!r}; allowed: a list of {len(kinds)}")
    return tuple(bind(kind, item, (*place, i)) for i, (kind, item) in enumerate(zip(kinds, content, strict=True)))


def _bind_union(kinds: tuple[Any, ...], content: Any, place: Place) -> Any:
    """None, then the tagged classes by their tag, then the first kind that is neither."""
    if content is None and type(None) in kinds:
        return None
    tagged = {kind.__name__.lower(): kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Tagged)}
    if tagged and isinstance(content, dict):
        if len(content) != 1:
            raise SchemaError(place, f"{_name(place)} has {len(content)} keys; allowed: one of {', '.join(tagged)}")
        (tag, inner), *_ = content.items()
        _known(tag, tagged, (*place, tag))
        return bind(tagged[tag], inner, (*place, tag))
    others = [kind for kind in kinds if kind is not type(None) and kind not in tagged.values()]
    if len(others) == 2 and isinstance(content, (list, tuple)) != (get_origin(others[0]) is tuple):
        others.reverse()
    try:
        return bind(others[0], content, place)
    except SchemaError as error:
        if not tagged:
            raise
        raise SchemaError(error.place, f"{error.reason}, or one of {', '.join(tagged)}") from None


def _bind_dataclass(kind: Any, content: Any, place: Place) -> Any:
    known = {field.name: field for field in fields(kind) if field.init}
    hints = get_type_hints(kind, include_extras=True)
    bare = len(known) == 1 and not isinstance(content, dict)  # its one field is the value itself
    if bare:
        values = {name: bind(hints[name], content, place) for name in known}
    else:
        values = _bind_keys({name: hints[name] for name in known}, content, place)
    for name, field in known.items():
        if name not in values and field.default is MISSING and field.default_factory is MISSING:
            raise SchemaError(place, f"the key {name!r} is missing")
    try:
        return kind(**values)
    except InputError as error:
        inner, reason = (error.place, error.reason) if isinstance(error, SchemaError) else ((), str(error))
        where = inner if bare else (*inner, *_named(_at(content, inner), reason))
        raise SchemaError((*place, *where), reason) from None


def _bind_keys(kinds: Mapping[str, Any], content: Any, place: Place) -> dict[str, Any]:
    for key in _mapping(content, place):
        _known(key, kinds, (*place, key))
    return {key: bind(kinds[key], value, (*place, key)) for key, value in content.items()}


def _mapping(content: Any, place: Place) -> Mapping[str, Any]:
    if not isinstance(content, dict):
        raise SchemaError(place, f"{_name(place)} = {content!r}; allowed: keys with values")
    return content


def _known(key: str, allowed: Iterable[str], place: Place) -> None:
    allowed = list(allowed)
    if key not in allowed:
        near = difflib.get_close_matches(key, allowed, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"allowed: {', '.join(allowed)}"
        raise SchemaError(place, f"there is no key {key!r}; {hint}")


def _at(content: Any, place: Place) -> Any:
    for step in place:
        content = content[step]
    return content


def _named(content: Any, reason: str) -> Place:
    """Where the input stands that a message begins with; nowhere when no key has that name."""
    match = re.match(r"[\w.]+", reason)
    waiting: list[tuple[Place, Any]] = [((), content)]
    while match and waiting:
        place, inner = waiting.pop(0)
        if isinstance(inner, dict):
            if match[0] in inner:
                return (*place, match[0])
            waiting += [((*place, key), value) for key, value in inner.items()]
    return ()


def plain(value: Any) -> Any:
    """What ``bind`` reads back: dataclasses as mappings; what is None, empty, or a mapping of nothing is left out.

    Examples
    --------
    >>> from fopid_core.study.experiments.profiles import Ramp
    >>> from fopid_core.study.experiments.yaml_schema import plain
    >>> plain({"setpoint": Ramp(to=2.0, over=5.0), "tune": None})
    {'setpoint': {'ramp': {'to': 2.0, 'over': 5.0}}}
    """
    if is_dataclass(value) and not isinstance(value, type):
        inner = {field.name: getattr(value, field.name) for field in fields(value)}
        content = plain(next(iter(inner.values()))) if len(inner) == 1 else plain(inner)
        return {type(value).__name__.lower(): content} if isinstance(value, Tagged) else content
    if isinstance(value, Mapping):
        kept = {key: plain(item) for key, item in value.items()}
        return {key: item for key, item in kept.items() if item is not None and item not in ("", {}, [])}
    return [plain(item) for item in value] if isinstance(value, (list, tuple)) else value


def yaml_text(value: Any) -> str:
    """The text of a file from which ``read_yaml`` makes the same dataclass."""
    text: str = yaml.dump(plain(value), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=110)
    return text
