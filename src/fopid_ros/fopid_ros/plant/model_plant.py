"""Any Python model as the plant: a class with ``step(u, dt)``, found by its name."""

from __future__ import annotations

import importlib
import inspect
import math
import reprlib
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from fopid_core.errors import InputError
from fopid_core.runtime.plant import PlantSettings

ALLOWED = "package.module:Class of a class without arguments, with step(u, dt) that returns the output after dt [s]"
_BRIEFLY = reprlib.Repr()
_BRIEFLY.maxother = _BRIEFLY.maxstring = 80


class ModelPlant:
    """``measurement = plant.step(control, disturbance)`` by a model's own ``y = step(u, dt)``.

    Parameters
    ----------
    name : str
        ``package.module:Class``. It is made anew by each reset; a number called ``measurement`` or ``output``, where it
        has one, is its output at the beginning. An array of one number is one as well.
    settings : PlantSettings
        Of which the sample time, the noise, its seed, the factor and, without that number, the initial output count.

    Raises
    ------
    InputError
        If there is no such class, or it is no model.
    """

    def __init__(self, name: str, settings: PlantSettings) -> None:
        self._name, self._settings = name, settings
        self._make = model_class(name)
        self.gain_factor = settings.gain_factor
        self.reset()

    def reset(self) -> None:
        """A new model; the noise starts anew."""
        self._model = self._asked("the class", self._make)
        if not callable(self._asked("step", lambda: getattr(self._model, "step", None))):
            raise InputError(f"model = {self._name!r} has no step(u, dt); allowed: {ALLOWED}")
        try:
            inspect.signature(self._model.step).bind(0.0, self._settings.sample_time)
        except TypeError as error:
            raise InputError(f"model = {self._name!r}: step(u, dt): {error}; allowed: {ALLOWED}") from None
        except ValueError:  # an extension's own function does not tell its arguments
            pass
        self._noise = np.random.default_rng(self._settings.seed)
        known = (self._asked(name, partial(getattr, self._model, name, None)) for name in ("measurement", "output"))
        begins = [value for value in known if value is not None and not callable(value)]
        self._keep((*begins, self._settings.initial_output)[0])

    def step(self, control: float, disturbance: float = 0.0) -> float:
        """Hold ``control + disturbance`` for one sample time; return the measurement after it.

        Raises
        ------
        InputError
            If the model fails, or returns no finite number.
        """
        u, dt = self.gain_factor * (control + disturbance), self._settings.sample_time
        self._keep(self._asked(f"step({u:.6g}, {dt:.6g})", lambda: self._model.step(u, dt)))
        return self.measurement

    def _asked(self, what: str, ask: Callable[[], Any]) -> Any:
        """What somebody else's code gives, whatever goes wrong in it."""
        try:
            return ask()
        except (Exception, SystemExit) as error:
            raise InputError(f"model = {self._name!r}: {what}: {_told(error)}; allowed: {ALLOWED}") from error

    def _keep(self, output: Any) -> None:
        value = _number(output)
        if not math.isfinite(value):
            raise InputError(f"model = {self._name!r} gave {_shown(output)}; allowed: a finite number")
        self.output, noise = value, self._settings.noise_std
        self.measurement = self.output + (noise * float(self._noise.standard_normal()) if noise else 0.0)


def _number(value: Any) -> float:
    """A number, or an array of one; NaN for anything else, whatever goes wrong in it."""
    try:
        if isinstance(value, str | bytes) or np.ma.is_masked(value):
            return math.nan
        return float(np.asarray(value, dtype=float).item())
    except Exception:  # a tensor that wants its gradient, an integer beyond all numbers  # noqa: BLE001
        return math.nan


def _shown(value: Any) -> str:
    try:
        return _BRIEFLY.repr(value)
    except Exception:  # noqa: BLE001  (somebody else's code)
        return f"a {type(value).__name__}"


def _told(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"


def model_class(name: str) -> Any:
    """The class of that name, or whatever else makes a model.

    Examples
    --------
    >>> model_class("fopid_core.runtime.plant:Plant").__name__
    'Plant'
    """
    module, _, attribute = name.partition(":")
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (Exception, SystemExit) as error:  # a module runs whatever it likes
        raise InputError(f"model = {name!r}: {_told(error)}; allowed: {ALLOWED}") from error
    if not callable(found):
        raise InputError(f"model = {name!r} is no class; allowed: {ALLOWED}")
    return found
