"""The general purpose registers through which programs and RTDE clients talk."""

from dataclasses import dataclass, field

INTEGERS, DOUBLES, BITS = 48, 48, 128


@dataclass
class Bank:
    """One direction's registers."""

    integers: list[int] = field(default_factory=lambda: [0] * INTEGERS)
    doubles: list[float] = field(default_factory=lambda: [0.0] * DOUBLES)
    bits: list[bool] = field(default_factory=lambda: [False] * BITS)

    def clear(self) -> None:
        """All zero. The lists stay the same: RTDE's recipes hold on to them."""
        self.integers[:], self.doubles[:], self.bits[:] = [0] * INTEGERS, [0.0] * DOUBLES, [False] * BITS

    def bits_word(self, first: int) -> int:
        """32 bits from number `first` on as one word, lowest first."""
        return sum(1 << k for k, bit in enumerate(self.bits[first : first + 32]) if bit)

    def set_bits_word(self, first: int, word: int) -> None:
        """The reverse of `bits_word`."""
        for k in range(32):
            self.bits[first + k] = bool(word >> k & 1)


@dataclass
class Registers:
    """Both directions, seen from the controller."""

    inputs: Bank = field(default_factory=Bank)
    """Written by RTDE clients."""
    outputs: Bank = field(default_factory=Bank)
    """Written by the program."""
