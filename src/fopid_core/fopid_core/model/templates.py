"""The reduced models of the paper, eqs. (6) to (9), by name."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from fopid_core.errors import InputError
from fopid_core.model.process import Process
from fopid_core.model.quasipolynomial import QuasiPolynomial, Term


@dataclass(frozen=True)
class Template:
    """A model structure with named parameters.

    Attributes
    ----------
    name : str
        What people type.
    title : str
        What the paper calls it.
    parameters : tuple of str
        Names of the parameters, ``K`` first and the delay ``L`` [s] last.

    Examples
    --------
    >>> str(TEMPLATES["foptd"].process({"K": 2, "T": 3, "L": 0.5}))
    '2/(3 s + 1) * exp(-0.5s)'
    """

    name: str
    title: str
    parameters: tuple[str, ...]
    _denominator: Callable[[Mapping[str, float]], QuasiPolynomial]

    def process(self, parameters: Mapping[str, float]) -> Process:
        """The process with these parameter values.

        Raises
        ------
        InputError
            If a parameter is missing, unknown, not finite, or the model is not proper and causal.
        """
        if set(parameters) != set(self.parameters):
            given, wanted = ", ".join(parameters) or "none", ", ".join(self.parameters)
            raise InputError(f"parameters {given} of {self.name}; allowed: exactly {wanted}")
        for name, value in parameters.items():
            if not math.isfinite(value):
                raise InputError(f"parameter {name} = {value} of {self.name}; allowed: a finite number")
        if parameters["L"] < 0:
            raise InputError(f"parameter L = {parameters['L']} of {self.name}; allowed: a delay >= 0 s")
        gain = QuasiPolynomial.monomial(parameters["K"], delay=parameters["L"])
        return Process(gain, self._denominator(parameters))


def _sum(*terms: tuple[float, float]) -> QuasiPolynomial:
    return QuasiPolynomial.of(Term(float(order), 0.0, float(coefficient)) for coefficient, order in terms)


TEMPLATES = {
    template.name: template
    for template in (
        Template("foptd", "FOPTD", ("K", "T", "L"), lambda p: _sum((p["T"], 1), (1, 0))),
        Template("soptd", "SOPTD", ("K", "a1", "a0", "L"), lambda p: _sum((1, 2), (p["a1"], 1), (p["a0"], 0))),
        Template("nioptd1", "NIOPTD-I", ("K", "T", "alpha", "L"), lambda p: _sum((p["T"], p["alpha"]), (1, 0))),
        Template(
            "nioptd2",
            "NIOPTD-II",
            ("K", "a1", "a0", "alpha", "beta", "L"),
            lambda p: _sum((1, p["alpha"]), (p["a1"], p["beta"]), (p["a0"], 0)),
        ),
    )
}
"""The four templates: eqs. (6) to (9), with a1 = 2 zeta omega_n and a0 = omega_n^2."""
