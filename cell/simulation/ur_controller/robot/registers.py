"""General purpose registers, for the communication between programs and RTDE clients."""

from dataclasses import dataclass, field

INTEGERS, DOUBLES, BITS = 48, 48, 128


@dataclass
class Bank:
    """Registers of one direction."""

    integers: list[int] = field(default_factory=lambda: [0] * INTEGERS)
    doubles: list[float] = field(default_factory=lambda: [0.0] * DOUBLES)
    bits: list[bool] = field(default_factory=lambda: [False] * BITS)

    def clear(self) -> None:
        """Set all registers to zero. The lists are kept, because RTDE recipes refer to them."""
        self.integers[:], self.doubles[:], self.bits[:] = [0] * INTEGERS, [0.0] * DOUBLES, [False] * BITS

    def bits_word(self, first: int) -> int:
        """Return 32 bits from number `first` on as one word, lowest bit first."""
        return sum(1 << k for k, bit in enumerate(self.bits[first : first + 32]) if bit)

    def set_bits_word(self, first: int, word: int) -> None:
        """Set the bits of a word, the reverse of `bits_word`."""
        for k in range(32):
            self.bits[first + k] = bool(word >> k & 1)


@dataclass
class Registers:
    """Registers of both directions, as seen from the controller."""

    inputs: Bank = field(default_factory=Bank)
    """Registers that RTDE clients write."""
    outputs: Bank = field(default_factory=Bank)
    """Registers that the program writes."""
