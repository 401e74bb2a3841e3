"""Any Python model as the plant: a class with ``step(u, dt)``, found by its name."""

from __future__ import annotations

import importlib
import math
from typing import Any

import numpy as np

from fopid_core.errors import InputError
from fopid_core.runtime.plant import PlantSettings

ALLOWED = "package.module:Class of a class without arguments, with step(u, dt) that returns the output after dt [s]"


class ModelPlant:
    """``measurement = plant.step(control, disturbance)`` by a model's own ``y = step(u, dt)``.

    Parameters
    ----------
    name : str
        ``package.module:Class``. It is made anew by each reset; a number called ``measurement`` or ``output``, where it
        has one, is its output at the beginning.
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
        try:
            self._model = self._make()
        except TypeError as error:
            raise InputError(f"model = {self._name!r}: {error}; allowed: {ALLOWED}") from None
        self._noise = np.random.default_rng(self._settings.seed)
        known = (getattr(self._model, attribute, None) for attribute in ("measurement", "output"))
        numbers = [value for value in known if isinstance(value, int | float)]
        self._keep((*numbers, self._settings.initial_output)[0])

    def step(self, control: float, disturbance: float = 0.0) -> float:
        """Hold ``control + disturbance`` for one sample time; return the measurement after it.

        Raises
        ------
        InputError
            If the model returns no finite number.
        """
        self._keep(self._model.step(self.gain_factor * (control + disturbance), self._settings.sample_time))
        return self.measurement

    def _keep(self, output: Any) -> None:
        try:
            self.output = float(output)
        except (TypeError, ValueError):
            self.output = math.nan
        if not math.isfinite(self.output):
            raise InputError(f"model = {self._name!r} gave {output!r}; allowed: a finite number")
        noise = self._settings.noise_std
        self.measurement = self.output + (noise * float(self._noise.standard_normal()) if noise else 0.0)


def model_class(name: str) -> Any:
    """The class of that name.

    Examples
    --------
    >>> model_class("fopid_core.runtime.plant:Plant").__name__
    'Plant'
    """
    module, _, attribute = name.partition(":")
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"model = {name!r}: {error}; allowed: {ALLOWED}") from None
    if not callable(getattr(found, "step", None)):
        raise InputError(f"model = {name!r} has no step(u, dt); allowed: {ALLOWED}")
    return found
