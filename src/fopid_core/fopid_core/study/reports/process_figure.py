"""What a run shows of its process without any model, beside the process that the bag names."""

from __future__ import annotations

import numpy as np

from fopid_core.design.identification.frequency_response import FrequencyResponse, frequency_response
from fopid_core.errors import InputError
from fopid_core.study.records import record_of_run
from fopid_core.study.reports.loop_figures import decibels, frequency_axis
from fopid_core.study.reports.plotly_parts import BLUE, RED, Figure, legend_above, line, segment
from fopid_core.study.reports.run import Run

_FEWEST = 4
"""Known frequencies that make a picture."""
_FINE = 200


def process_figure(run: Run) -> Figure | None:
    """Size and angle behind the hold of the control with bars of 95 %; None where the run shows too little.

    See Also
    --------
    fopid_core.design.identification.frequency_response.frequency_response : How it is estimated.
    """
    control = run.signals.get("control")
    if control is None or not control.time.size:
        return None
    try:
        seen = frequency_response(record_of_run(run))
    except InputError:  # no record to learn from: too short, or broken
        return None
    return _figure(run, seen) if int(seen.known.sum()) >= _FEWEST else None


def _figure(run: Run, seen: FrequencyResponse) -> Figure:
    known = seen.known
    w, response, share = seen.frequency[known], seen.response[known], (seen.radius / np.abs(seen.response))[known]
    size, angle = decibels(response), np.unwrap(np.angle(response))
    data: list[Figure] = []
    marks: list[Figure] = []
    if run.process is not None and run.process.relative_degree > 0.0:  # else what it shows depends on the instant
        fine = np.geomspace(w[0], w[-1], _FINE)
        named = seen.at(run.process, fine)
        turned = np.unwrap(np.angle(named))
        beside = np.interp(w, fine, turned)
        angle = beside + np.angle(response * np.exp(-1j * beside))  # so that both are seen on the same turn
        data += [line(fine, decibels(named), "the process named", BLUE),
                 line(fine, np.degrees(turned), "the process named", BLUE, yaxis="y2", showlegend=False)]  # fmt: skip
    dot: Figure = {"mode": "markers", "marker": {"size": 5, "color": RED}}
    data += [line(w, size, "the run, without a model, 95 %", RED, **dot),
             line(w, np.degrees(angle), "the run", RED, yaxis="y2", showlegend=False, **dot)]  # fmt: skip
    for x, y, turn, part in zip(w.tolist(), size.tolist(), np.degrees(angle).tolist(), share.tolist(), strict=True):
        spread = float(np.degrees(np.arcsin(part)))
        marks.append(segment((x, x), (y + float(decibels(1.0 - part)), y + float(decibels(1.0 + part))), RED))
        marks.append(segment((x, x), (turn - spread, turn + spread), RED, yref="y2"))
    layout = {
        "xaxis": frequency_axis(anchor="y2"),
        "yaxis": {"title": {"text": "size [dB]"}, "domain": [0.54, 1.0]},
        "yaxis2": {"title": {"text": "angle [°]"}, "domain": [0.0, 0.46]},
        "shapes": marks, "showlegend": True, "legend": legend_above(),
    }  # fmt: skip
    return {"data": data, "layout": layout}
