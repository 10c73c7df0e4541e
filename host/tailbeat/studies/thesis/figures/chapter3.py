"""Figures 3.1 to 3.5."""

from __future__ import annotations

from dataclasses import replace

from tailbeat.core.arrays import F64
from tailbeat.report.style import Axes
from tailbeat.studies.thesis.chapter3 import EX1, EX2, ORDERS, of_order
from tailbeat.studies.thesis.example import figure
from tailbeat.studies.thesis.picture import REFERENCE, THIN, Curve, Panel, Panels, errors
from tailbeat.studies.thesis.plants import held
from tailbeat.studies.thesis.series import error_profiles
from tailbeat.studies.thesis.study import Study

_SEEDS = range(1, 61)
_LAST1, _LAST2 = 20, 30
_BAND = f"median, 80 % of {len(_SEEDS)} seeds (grey)"


def _spread(setting: held.Moving, last: int) -> F64:
    """Errors of many series of random lengths."""
    return setting.problem().series(_SEEDS, last).max_abs_error


@figure(EX1, "3.1", "largest error over the iterations, m = 4. The text: 2.351 to 0.003035.")
def _errors1(study: Study) -> Panel:
    uncut = study.setting.problem().uncut(_LAST1)
    band = (_BAND, _spread(study.setting, _LAST1))
    return errors({"uncut trials": uncut}, band=band, levels=[0.003035])


@figure(EX1, "3.2", "errors of iterations 1, 4, 10 and 16 over a trial; dots end the trials.")
def _profiles1(study: Study) -> Panel:
    shown = (1, 4, 10, 16)
    found = study.setting.problem().series([1], max(shown), keep=shown)
    return error_profiles(found, shown, "$t$ (s)", "$e_i(t)$")


@figure(
    EX1, "3.3", "largest error over the iterations for m = 0 to 5, uncut trials. Left: the gain of"
    " each trial is kept; right: their sum.",
)  # fmt: skip
def _orders(study: Study) -> Panels:
    panels = []
    for total, name in ((False, r"$\beta_j = 1/5$"), (True, r"$\beta_j = 1/(m+1)$")):
        settings = {m: of_order(study.setting, m, total) for m in ORDERS}
        found = {f"m = {m}": one.problem().uncut(_LAST1) for m, one in settings.items()}

        def named(axes: Axes, name: str = name) -> None:
            axes.annotate(name, (0.03, 0.04), xycoords="axes fraction")

        panels.append(errors(found, columns=3, more=named, ylim=(1e-9, 8.0)))
    return Panels(panels)


@figure(EX2, "3.4", "largest error of the fish's speed over the iterations, drag v|v|.")
def _errors2(study: Study) -> Panel:
    pushing = replace(study.setting, low=0.0)
    band = (_BAND, _spread(study.setting, _LAST2))
    found = {"u ≥ 0, uncut": pushing.problem().uncut(_LAST2)}
    label = r"$\max_t\,|e_i(t)|$ (m/s)"
    return errors(found, band=band, ylabel=label)


@figure(EX2, "3.5", "errors of iterations 1, 5, 10 and 20 over a trial; dots end the trials.")
def _profiles2(study: Study) -> Panel:
    shown = (1, 5, 10, 20)
    found = study.setting.problem().series([1], max(shown), keep=shown)
    return error_profiles(found, shown, "$t$ (s)", "$e_i(t)$ (m/s)")


@figure(
    EX2, "3-thrust", "thrust that the reference needs and that was learned; right: the end,"
    " enlarged.",
)  # fmt: skip
def _thrust(study: Study) -> Panels:
    found = study.traces
    times, learned = found.problem.times, found.trial()[0]

    def zero(axes: Axes) -> None:
        axes.axhline(0.0, **THIN)

    curves = [
        Curve(times, 1e3 * held.fish_exact_input(times), "needed, $u_d$", REFERENCE),
        Curve(times, 1e3 * learned, f"learned, iteration {max(found.kept)}"),
    ]
    labels = {"xlabel": "$t$ (s)", "ylabel": "thrust per mass (mm/s$^2$)"}
    end = {**labels, "xlim": (40.0, 50.0), "ylim": (-8.0, 12.0)}
    return Panels([Panel(curves, labels, more=zero), Panel(curves, end, more=zero)])
