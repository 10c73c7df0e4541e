"""trim."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.app.cli._live_camera import LiveOptions, live_camera
from tailbeat.app.cli._options import (
    CalibrationOption,
    CameraOption,
    LatencyOption,
    MarkerIdOption,
    MarkerKindOption,
    MarkerSideOption,
    marker_of,
)
from tailbeat.app.cli._terminal import Connect, Json, connected, say

if TYPE_CHECKING:
    from tailbeat.app.cli._display import Display
    from tailbeat.app.cli._live_camera import Live
    from tailbeat.board.fish import Fish
    from tailbeat.session.collect import Swum
    from tailbeat.session.operator import Decision, Event, Person
    from tailbeat.session.trim import Trim


def trim(
    apply: Annotated[
        bool | None,
        typer.Option(
            "--apply/--no-apply",
            help="Set SERVO_CENTRE_US to what is found, for good; default: asked.",
            show_default=False,
        ),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before each swim.")] = False,
    rest: Annotated[
        float,
        typer.Option("--rest", min=0.0, max=3600.0, metavar="S", help="Rest before each swim."),
    ] = 30.0,
    camera: CameraOption = None,
    calibration: CalibrationOption = None,
    marker: MarkerKindOption = "aruco",
    marker_id: MarkerIdOption = None,
    marker_side: MarkerSideOption = None,
    latency: LatencyOption = 0.0,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Find the servo pulse with the tail straight, by how the fish turns over two short swims.

    The tail's centre is set a little to either side, and put back; what the board has learned
    stays. Nothing is changed for good before you say so.

    Example: tailbeat trim
    """
    on_fish = marker_of(marker, marker_id, marker_side)
    options = LiveOptions(camera, on_fish, calibration, latency, None, None).check()
    with connected(connect) as fish, live_camera(fish, options) as live:
        found, held = _trimmed(fish, live, _Asked(apply, yes, rest, json))
        document = _document(found, held)
        say(json, document, lambda: _text(found, held))


@dataclass(frozen=True)
class _Asked:
    """What was given on the command line."""

    apply: bool | None
    yes: bool
    rest_s: float
    json: bool


def _trimmed(fish: Fish, live: Live, asked: _Asked) -> tuple[Trim, float | None]:
    """What was found, and what is set now if it was applied."""
    from tailbeat.app.cli._display import Display
    from tailbeat.app.cli._keyboard import terminal_keys
    from tailbeat.session.preflight.step import Wanted
    from tailbeat.session.trim import apply, find_centre

    simulated = fish.info().simulated
    with Display(quiet=asked.json) as display, terminal_keys() as keys:
        there = keys is not None and display.moves
        alone = asked.yes or simulated
        _require_somebody(alone or there)
        person = _person(display, keys if there else None, alone)
        wanted = Wanted(rest_s=asked.rest_s)
        found = find_centre(fish, person, live.camera, live.guard, wanted)
        wants = asked.apply
        if wants is None and there and not asked.json:
            display.keep(found.text())
            wants = _person(display, keys, False).confirm("Set it for good?")
        return found, apply(fish, found) if wants else None


def _require_somebody(there: bool) -> None:
    from tailbeat.core.errors import InputError

    if not there:
        raise InputError(
            "nobody can be asked before each swim here.",
            "Add --yes when the fish is free to swim twice by itself, or call it at a terminal.",
        )


def _person(display: Display, keys: Any, alone: bool) -> Person:
    from tailbeat.app.cli._operator import TerminalPerson

    person = TerminalPerson(display, keys)
    return _Willing(person) if alone else person


@dataclass(frozen=True)
class _Willing:
    """Says yes to every swim; all else is the person's."""

    person: Person

    def tell(self, event: Event) -> None:
        """Passes it on."""
        self.person.tell(event)

    def wants_abort(self) -> bool:
        """As the person does."""
        return self.person.wants_abort()

    def decide(self, swum: Swum) -> Decision:
        """As the person does."""
        return self.person.decide(swum)

    def confirm(self, question: str) -> bool:
        """Yes."""
        return True


def _document(found: Trim, held: float | None) -> dict[str, Any]:
    return {
        "was_us": found.was_us,
        "centre_us": found.centre_us,
        "sigma_us": found.sigma_us,
        "turn_before_rad_m": found.turn_rad(found.was_us, 1.0),
        "turn_sigma_rad_m": abs(found.turn_rad_m_us) * found.sigma_us,
        "source": found.source,
        "swims": found.swims,
        "applied": held is not None,
        "held_us": held,
    }


def _text(found: Trim, held: float | None) -> str:
    if held is not None:
        return f"{found.text()}\nset for good: SERVO_CENTRE_US {held:.1f}"
    return (
        f"{found.text()}\nnothing was changed; to set it: tailbeat params set SERVO_CENTRE_US "
        f"{found.centre_us:.1f}, tailbeat params save"
    )
