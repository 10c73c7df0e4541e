"""board key set, status, list, erase, export, import, delete."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from tailbeat.app.cli._connect import connected
from tailbeat.app.cli._options import Connect, Json
from tailbeat.app.cli._terminal import echo, say
from tailbeat.board.provision import KeyStatus, erase_key, key_status, set_key
from tailbeat.core.errors import InputError, reason
from tailbeat.link.keystore import KeyStore, StoredKey, decode_key, encode_key, write_private

Which = Annotated[
    str,
    typer.Argument(metavar="KEY", help="Fingerprint, name or board, as in 'board key list'."),
]


def set_(
    name: Annotated[str, typer.Option("--name", help="What to call it on this computer.")] = "",
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Give the board a new key. Needs the USB port.

    From then on the board accepts only commands signed with this key.

    Example: tailbeat board key set --connect /dev/ttyACM0
    """
    with connected(connect, notice=False) as fish, _told_when_interrupted():
        key = set_key(fish, name)
    say(
        json,
        key.public(),
        f"the board signs with key {key.fingerprint} now, and so does this computer; a second one"
        " gets it with: tailbeat board key export FILE",
    )


@contextlib.contextmanager
def _told_when_interrupted() -> Iterator[None]:
    """A key that was kept here may have reached the board or not."""
    before = KeyStore().usable()
    try:
        yield
    except KeyboardInterrupt:
        if KeyStore().usable() != before:
            echo(
                "tailbeat: interrupted: the board may have the new key or not; look with:"
                " tailbeat board key status",
                err=True,
            )
        raise


def status(connect: Connect = None, json: Json = False) -> None:
    """Print whether the board has a key, whether it is here, and what the board refused.

    Example: tailbeat board key status
    """
    with connected(connect, notice=False) as fish:
        found = key_status(fish)
    say(json, found.as_dict(), lambda: _status_text(found))


def _status_text(found: KeyStatus) -> str:
    lines = [f"board      {found.board or 'only for authenticated hosts'}"]
    if found.held is not None:
        named = f" ({found.held.name})" if found.held.name else ""
        lines.append(f"key        {found.held.fingerprint}{named}, set {found.held.created}")
    elif found.trust == "missing":
        lines.append(
            "key        only on the board, not on this computer: tailbeat board key import"
        )
    else:
        lines.append("key        none: anyone in radio range can move it: tailbeat board key set")
    if found.lost is not None:
        lines.append(
            f"lost       key {found.lost.fingerprint}: this computer has it, the board has not any"
            " more"
        )
    counts = ", ".join(f"{n.removeprefix('refused_')} {v}" for n, v in found.refused.items())
    lines.append(f"refused    {counts or 'not counted by this firmware'}")
    return "\n".join(lines)


def list_(json: Json = False) -> None:
    """Print the keys on this computer.

    Example: tailbeat board key list
    """
    store = KeyStore()
    keys, problems = store.load()
    for line in problems:
        echo(f"tailbeat: {line}", err=True)
    rows = [
        f"{key.fingerprint}  board {key.board}  {key.created}  {key.name}"
        + ("" if key.confirmed else "  (not heard from its board yet)")
        for key in keys
    ]
    document = {"folder": store.folder, "keys": [key.public() for key in keys]}
    say(json, document, "\n".join(row.rstrip() for row in rows) or "no keys on this computer")


def erase(connect: Connect = None, json: Json = False) -> None:
    """Delete the key on the board and on this computer. Needs the USB port.

    Example: tailbeat board key erase --connect /dev/ttyACM0
    """
    with connected(connect, notice=False) as fish:
        key = erase_key(fish)
    document = {"erased": None if key is None else key.public()}
    say(json, document, "the board has no key: anyone in radio range can move its tail")


def export(
    file: Annotated[
        Path | None, typer.Argument(metavar="FILE", help="Where to; default: print it.")
    ] = None,
    key: Annotated[
        str | None,
        typer.Option("--key", metavar="KEY", help="Which one, if there are several."),
    ] = None,
    json: Json = False,
) -> None:
    """Write a key into a file, for another computer. The file is a secret.

    Example: tailbeat board key export fish.key
    """
    found = KeyStore().find(key)
    secret = "whoever has it can move the tail; delete it when it has arrived"
    if file is None:
        echo(f"tailbeat: this is a secret: {secret}", err=True)
        sys.stdout.write(encode_key(found).decode())
        return
    try:
        write_private(file, encode_key(found), anew=True)
    except FileExistsError:
        raise InputError(f"{file} exists already", "Delete it or take another name.") from None
    except OSError as error:
        raise InputError(
            f"cannot write {file} ({reason(error)})",
            "Check the path, your rights there and the free space.",
        ) from error
    document = found.public() | {"file": str(file)}
    say(json, document, f"wrote key {found.fingerprint} to {file}: {secret}")


def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="What export wrote; - = stdin.")],
    json: Json = False,
) -> None:
    """Read a key from another computer.

    Example: tailbeat board key import fish.key
    """
    if str(file) == "-":
        content, where = sys.stdin.buffer.read(), "what came in"
    else:
        content, where = file.read_bytes(), str(file)
    key = KeyStore().add(decode_key(content, where))
    say(json, key.public(), lambda: _import_text(key, file))


def _import_text(key: StoredKey, file: Path) -> str:
    line = f"this computer has key {key.fingerprint} of board {key.board[:8]}"
    return line if str(file) == "-" else f"{line}; delete {file} now"


def delete(which: Which, json: Json = False) -> None:
    """Delete a key on this computer. The board keeps it: make sure that somebody else has it.

    Example: tailbeat board key delete 3fa2b1c0
    """
    store = KeyStore()
    key = store.find(which)
    store.delete(key)
    say(
        json,
        {"forgotten": key.public()},
        f"this computer has key {key.fingerprint} no more; board {key.board[:8]} keeps it",
    )
