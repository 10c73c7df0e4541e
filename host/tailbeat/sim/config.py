"""What a simulator is made with: plant, seed and the values of sim_config_t."""

from __future__ import annotations

import os
import socket
from dataclasses import asdict, dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from tailbeat.core.errors import InputError, did_you_mean
from tailbeat.core.extras import lazy
from tailbeat.core.native import ffi, lib
from tailbeat.link.sockets import TcpTransport
from tailbeat.link.transport import Transport

if TYPE_CHECKING:
    from tailbeat.core import decode
else:
    decode = lazy("tailbeat.core.decode")

PLANTS = {"thesis": 0, "tank": 1, "reactive": 2}
DEFAULT_SEED = 1

_TIMEOUT_S = 1.0
_LONGEST_BYTES = 20_000
# Places of that port behind the radio's and behind the wired console's (simserver.py).
_BEHIND_RADIO, _BEHIND_CONSOLE = 3, 1


def board_number(seed: float | None) -> int:
    """What tells a simulated board from others, the last 8 bytes of its unique id: the seed if one
    is given, so that it is the same board each time; otherwise random."""
    return int.from_bytes(os.urandom(8), "little") if seed is None else int(seed)


def make_config(plant: str, seed: float, overrides: dict[str, float]) -> Any:
    """A sim_config_t. Raises InputError for names there are none of."""
    if plant not in PLANTS:
        raise InputError(
            f"there is no plant {plant}",
            f"{did_you_mean(plant, PLANTS)}Use one of: {', '.join(PLANTS)}.",
        )
    if not 0 <= seed < 1 << 64 or seed != int(seed):
        raise InputError(f"{seed} is no seed", "Give a whole number from 0 to 2^64 - 1.")
    config = ffi.new("sim_config_t *")
    lib.sim_config_default(config, PLANTS[plant])
    config.seed = int(seed)
    for name, value in overrides.items():
        setattr(config, config_field(name), value)
    return config


def senseless() -> InputError:
    """The error for values that fit no world."""
    return InputError("the simulator cannot run with these values", "Check them: SI units.")


def config_values(config: Any) -> dict[str, float]:
    """All values of a sim_config_t by name."""
    return {name: getattr(config, name) for name in config_fields()}


@cache
def config_fields() -> tuple[str, ...]:
    """Names of all values of the simulator's configuration."""
    return tuple(name for name, _ in ffi.typeof("sim_config_t").fields)


@cache
def config_field(name: str) -> str:
    """The field meant by ``name``; its unit may be left out (kappa = kappa_per_m)."""
    fields = [f for f in config_fields() if f not in ("seed", "plant")]
    matches = [f for f in fields if f == name] or [f for f in fields if f.startswith(name + "_")]
    if len(matches) > 1:
        raise InputError(f"{name} may mean {', '.join(matches)}", "Write one of them.")
    if not matches:
        raise InputError(
            f"the simulator has no value {name}",
            f"{did_you_mean(name, _with_short(fields))}It has: {', '.join(fields)}.",
        )
    return matches[0]


def _with_short(fields: list[str]) -> list[str]:
    """Also without their units, as they may be given."""
    units = ("_per_m", "_m_s_rad", "_m_s", "_rad_s", "_rad", "_kg_m", "_kg", "_m", "_s", "_v")
    unit_of = {field: next(filter(field.endswith, units), "") for field in fields}
    short = [field.removesuffix(unit) for field, unit in unit_of.items()]
    clear = [one for one in short if sum(field.startswith(f"{one}_") for field in fields) == 1]
    return list(dict.fromkeys([*fields, *clear]))


@dataclass(frozen=True)
class _Settings:
    """The answer to ``config``."""

    plant: str
    seed: int
    simulator: dict[str, Any]


def simulator_settings(transport: Transport) -> dict[str, Any]:
    """``plant``, ``seed`` and ``simulator`` (its values) of the simulator behind ``transport``.

    Empty when the simulator does not say: it is an older one, its ports are not in a row, or
    another program uses the fault-injection port.
    """
    if not isinstance(transport, TcpTransport):
        return {}
    for behind in (_BEHIND_RADIO, _BEHIND_CONSOLE):
        try:
            address = transport.host, transport.port + behind
            with socket.create_connection(address, _TIMEOUT_S) as connection:
                connection.sendall(b"config\n")
                line = connection.makefile("rb").readline(_LONGEST_BYTES)
            return asdict(decode.decode(line, _Settings, "the simulator", ""))
        except ConnectionRefusedError:
            continue
        except (OSError, OverflowError, InputError):
            break
    return {}
