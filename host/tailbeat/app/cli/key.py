"""board key set, status, list, erase, export, import, delete."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from tailbeat.app.cli._fish import FishWithoutNotice
from tailbeat.app.cli._lazy import arg, opt
from tailbeat.app.cli._terminal import Output, lines_of, warn
from tailbeat.board.provision import KeyStatus, erase_key, key_status, set_key
from tailbeat.core.errors import InputError, reason
from tailbeat.link.keystore import KeyStore, decode_key, encode_key, write_private

Which = Annotated[str, arg("Fingerprint, name or board, as in 'board key list'.", "KEY")]


def set_(
    fish: FishWithoutNotice,
    name: str = opt("What to call it on this computer.", default=""),
) -> Output:
    """Give the board a new key. Needs the USB port.

    From then on the board accepts only commands signed with this key.

    Example: tailbeat board key set --connect /dev/ttyACM0
    """
    before = KeyStore().usable()
    try:
        key = set_key(fish, name)
    except KeyboardInterrupt:  # a key that was kept here may have reached the board or not
        if KeyStore().usable() != before:
            warn(
                "interrupted: the board may have the new key or not; look with:"
                " tailbeat board key status"
            )
        raise
    return Output(
        key.public(),
        f"the board signs with key {key.fingerprint} now, and so does this computer; a second one"
        " gets it with: tailbeat board key export FILE",
    )


def status(fish: FishWithoutNotice) -> Output:
    """Print whether the board has a key, whether it is here, and what the board refused.

    Example: tailbeat board key status
    """
    found = key_status(fish)
    return Output(found.as_dict(), lambda: _status_text(found))


def _status_text(found: KeyStatus) -> str:
    held, lost = found.held, found.lost
    if held is not None:
        named = f" ({held.name})" if held.name else ""
        key = f"{held.fingerprint}{named}, set {held.created}"
    elif found.trust == "missing":
        key = "only on the board, not on this computer: tailbeat board key import"
    else:
        key = "none: anyone in Bluetooth range can move it: tailbeat board key set"
    counts = ", ".join(f"{n.removeprefix('refused_')} {v}" for n, v in found.refused.items())
    return lines_of(
        f"board      {found.board or 'only for authenticated hosts'}",
        f"key        {key}",
        lost
        and f"lost       key {lost.fingerprint}: this computer has it, the board has not any more",
        f"refused    {counts or 'not counted by this firmware'}",
    )


def list_() -> Output:
    """Print the keys on this computer.

    Example: tailbeat board key list
    """
    store = KeyStore()
    keys, problems = store.load()
    for line in problems:
        warn(line)
    rows = [
        f"{key.fingerprint}  board {key.board}  {key.created}  {key.name}"
        + ("" if key.confirmed else "  (not heard from its board yet)")
        for key in keys
    ]
    document = {"folder": store.folder, "keys": [key.public() for key in keys]}
    return Output(document, "\n".join(row.rstrip() for row in rows) or "no keys on this computer")


def erase(fish: FishWithoutNotice) -> Output:
    """Delete the key on the board and on this computer. Needs the USB port.

    Example: tailbeat board key erase --connect /dev/ttyACM0
    """
    key = erase_key(fish)
    document = {"erased": None if key is None else key.public()}
    return Output(document, "the board has no key: anyone in Bluetooth range can move its tail")


def export(
    file: Path | None = arg("Where to; default: print it.", "FILE"),
    key: str | None = opt("Which one, if there are several.", "KEY"),
) -> Output | None:
    """Write a key into a file, for another computer. The file is a secret.

    Example: tailbeat board key export fish.key
    """
    found = KeyStore().find(key)
    secret = "whoever has it can move the tail; delete it when it has arrived"
    if file is None:
        warn(f"this is a secret: {secret}")
        sys.stdout.write(encode_key(found).decode())
        return None
    try:
        write_private(file, encode_key(found), anew=True)
    except FileExistsError:
        raise InputError(f"{file} exists already", "Delete it or take another name.") from None
    except OSError as error:
        remedy = "Check the path, your rights there and the free space."
        raise InputError(f"cannot write {file} ({reason(error)})", remedy) from error
    document = found.public() | {"file": str(file)}
    return Output(document, f"wrote key {found.fingerprint} to {file}: {secret}")


def import_(
    file: Path = arg("What export wrote; - = stdin.", "FILE"),
) -> Output:
    """Read a key from another computer.

    Example: tailbeat board key import fish.key
    """
    if str(file) == "-":
        content, where = sys.stdin.buffer.read(), "what came in"
    else:
        content, where = file.read_bytes(), str(file)
    key = KeyStore().add(decode_key(content, where))
    text = f"this computer has key {key.fingerprint} of board {key.board[:8]}"
    return Output(key.public(), text if str(file) == "-" else f"{text}; delete {file} now")


def delete(which: Which) -> Output:
    """Delete a key on this computer. The board keeps it: make sure that somebody else has it.

    Example: tailbeat board key delete 3fa2b1c0
    """
    store = KeyStore()
    key = store.find(which)
    store.delete(key)
    text = f"this computer has key {key.fingerprint} no more; board {key.board[:8]} keeps it"
    return Output({"forgotten": key.public()}, text)
