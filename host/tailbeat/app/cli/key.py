"""key set, status, list, erase, export, import, forget."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tailbeat.app.cli._terminal import Connect, Json, connected, echo, say

if TYPE_CHECKING:
    from tailbeat.board.provision import KeyStatus
    from tailbeat.link.keystore import StoredKey

app = typer.Typer(
    no_args_is_help=True,
    help="The key without which a board obeys nobody, and who has it.",
)

Which = Annotated[
    str,
    typer.Argument(metavar="KEY", help="Fingerprint, name or board, as 'tailbeat key list' says."),
]


@app.command("set")
def set_(
    name: Annotated[str, typer.Option("--name", help="What to call it on this computer.")] = "",
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Give the board a new key; from then on it obeys only those who have it. Needs the wired port.

    Example: tailbeat key set --connect /dev/ttyACM0
    """
    from tailbeat.board.provision import set_key

    with connected(connect, notice=False) as fish, _told_when_interrupted():
        key = set_key(fish, name)
    say(
        json,
        key.public(),
        f"the board signs with key {key.fingerprint} now, and so does this computer; a second one"
        " gets it with: tailbeat key export FILE",
    )


@contextlib.contextmanager
def _told_when_interrupted() -> Iterator[None]:
    """A key that was kept here may have reached the board or not."""
    from tailbeat.link.keystore import KeyStore

    before = KeyStore().usable()
    try:
        yield
    except KeyboardInterrupt:
        if KeyStore().usable() != before:
            echo(
                "tailbeat: interrupted: the board may have the new key or not; look with: tailbeat"
                " key status",
                err=True,
            )
        raise


@app.command()
def status(connect: Connect = None, json: Json = False) -> None:
    """Whether the board has a key, whether it is here, and what the board turned away.

    Example: tailbeat key status
    """
    from tailbeat.board.provision import key_status

    with connected(connect, notice=False) as fish:
        found = key_status(fish)
    say(json, found.as_dict(), lambda: _status_text(found))


def _status_text(found: KeyStatus) -> str:
    lines = [f"board      {found.board or 'does not tell strangers who it is'}"]
    if found.held is not None:
        named = f" ({found.held.name})" if found.held.name else ""
        lines.append(f"key        {found.held.fingerprint}{named}, set {found.held.created}")
    elif found.trust == "missing":
        lines.append("key        the board has one, this computer has not: tailbeat key import")
    else:
        lines.append("key        none: anyone in radio range can move this tail: tailbeat key set")
    if found.lost is not None:
        lines.append(
            f"lost       key {found.lost.fingerprint}: this computer has it, the board has not any"
            " more"
        )
    counts = ", ".join(f"{n.removeprefix('refused_')} {v}" for n, v in found.refused.items())
    lines.append(f"refused    {counts or 'not counted by this firmware'}")
    return "\n".join(lines)


@app.command("list")
def list_(json: Json = False) -> None:
    """The keys on this computer.

    Example: tailbeat key list
    """
    from tailbeat.link.keystore import KeyStore

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


@app.command()
def erase(connect: Connect = None, json: Json = False) -> None:
    """Take the key away from the board and from this computer. Needs the wired port.

    Example: tailbeat key erase --connect /dev/ttyACM0
    """
    from tailbeat.board.provision import erase_key

    with connected(connect, notice=False) as fish:
        key = erase_key(fish)
    document = {"erased": None if key is None else key.public()}
    say(json, document, "the board has no key: anyone in radio range can move its tail")


@app.command()
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
    """Write a key into a file, to carry it to a second computer. The file is a secret.

    Example: tailbeat key export fish.key
    """
    from tailbeat.core.errors import InputError, reason
    from tailbeat.link.keystore import KeyStore, encode_key, write_private

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


@app.command("import")
def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="What export wrote; - = stdin.")],
    json: Json = False,
) -> None:
    """Take in a key from another computer.

    Example: tailbeat key import fish.key
    """
    from tailbeat.link.keystore import KeyStore, decode_key

    if str(file) == "-":
        content, where = sys.stdin.buffer.read(), "what came in"
    else:
        content, where = file.read_bytes(), str(file)
    key = KeyStore().add(decode_key(content, where))
    say(json, key.public(), lambda: _import_text(key, file))


def _import_text(key: StoredKey, file: Path) -> str:
    line = f"this computer has key {key.fingerprint} of board {key.board[:8]}"
    return line if str(file) == "-" else f"{line}; delete {file} now"


@app.command()
def forget(which: Which, json: Json = False) -> None:
    """Remove a key from this computer. The board keeps it: make sure that somebody else has it.

    Example: tailbeat key forget 3fa2b1c0
    """
    from tailbeat.link.keystore import KeyStore

    store = KeyStore()
    key = store.find(which)
    store.forget(key)
    say(
        json,
        {"forgotten": key.public()},
        f"this computer has key {key.fingerprint} no more; board {key.board[:8]} keeps it",
    )
