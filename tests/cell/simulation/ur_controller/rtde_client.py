"""An independent RTDE client, written from the description of the protocol."""

import socket
import struct
from collections.abc import Sequence
from typing import Any

PORT = 30004
_FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}


class RtdeClient:
    """Connection with protocol version 2 by default."""

    def __init__(self, host: str, version: int = 2) -> None:
        self.socket = socket.create_connection((host, PORT), timeout=10.0)
        self._buffer = b""
        self._names: list[str] = []
        self._layout = struct.Struct("")
        self._head = 1 if version > 1 else 0
        self.messages: list[str] = []
        """Texts that the controller sent."""
        if version > 1:
            assert self.ask("V", struct.pack(">H", version)) == b"\x01"

    def __enter__(self) -> "RtdeClient":
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def send(self, kind: str, payload: bytes = b"") -> None:
        """Send a package."""
        self.socket.sendall(struct.pack(">HB", 3 + len(payload), ord(kind)) + payload)

    def ask(self, kind: str, payload: bytes = b"") -> bytes:
        """Send a package and return the answer of the same kind."""
        self.send(kind, payload)
        return self.package(kind)

    def package(self, kind: str) -> bytes:
        """Return the payload of the next package of a kind. Text messages are kept, other packages are discarded."""
        while True:
            size, got = struct.unpack(">HB", self._read(3))
            payload = self._read(size - 3)
            if chr(got) == "M":
                self.messages.append(payload[1 : 1 + payload[0]].decode())
            if chr(got) == kind:
                return payload

    def _read(self, count: int) -> bytes:
        while len(self._buffer) < count:
            part = self.socket.recv(1 << 16)
            if not part:
                raise ConnectionError("the controller closed the connection")
            self._buffer += part
        data, self._buffer = self._buffer[:count], self._buffer[count:]
        return data

    def outputs(self, names: Sequence[str], hz: float = 500.0) -> tuple[int, list[str]]:
        """Request output variables and return the number of their recipe and their types."""
        head = struct.pack(">d", hz) if self._head else b""
        answer = self.ask("O", head + ",".join(names).encode())
        types = answer[self._head :].decode().split(",")
        self._names = list(names)
        self._types = types
        self._layout = struct.Struct(">" + "".join(_FORMATS.get(kind, "") for kind in types))
        return answer[0] if self._head else 1, types

    def inputs(self, names: Sequence[str]) -> tuple[int, list[str]]:
        """Set up input variables and return the number of their recipe and their types."""
        answer = self.ask("I", ",".join(names).encode())
        return answer[0], answer[1:].decode().split(",")

    def start(self) -> bool:
        """Start the data stream."""
        return self.ask("S") == b"\x01"

    def pause(self) -> bool:
        """Pause the data stream."""
        return self.ask("P") == b"\x01"

    def data(self) -> dict[str, Any]:
        """Return the next data package."""
        payload = self.package("U")
        assert len(payload) == self._head + self._layout.size
        flat = list(self._layout.unpack(payload[self._head :]))
        values = {}
        for name, kind in zip(self._names, self._types, strict=True):
            count = int(kind[6]) if kind.startswith("VECTOR") else 1
            values[name] = flat[:count] if kind.startswith("VECTOR") else flat[0]
            del flat[:count]
        return values

    def drain(self) -> None:
        """Read data until an error occurs."""
        while True:
            self.data()

    def write(self, recipe: int, layout: str, *values: float) -> None:
        """Write the variables of an input recipe."""
        self.send("U", bytes([recipe]) + struct.pack(">" + layout, *values))
