"""The codec of V2X messages in plain Python: the oracle of the compiled one, which `v2x.asn1.uper` declares.

`v2x.asn1.layout` describes programs and flat values. The clauses cited here are those of X.691 (02/2021).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np

from mast_zenoh.v2x.asn1.asn1_types import LONGEST
from mast_zenoh.v2x.asn1.layout import NodeKind, Op
from mast_zenoh.v2x.asn1.uper import CodecFault, Refusal, Values


def decode_values(program: Values, data: bytes) -> tuple[Values | None, Refusal | None]:
    """The flat values of a message, or why it is refused."""
    decoder = _Decoder(program.tolist(), data)
    try:
        decoder.message()
    except _Refused as refused:
        return None, (int(refused.fault), refused.found, tuple(decoder.path))
    return np.array(decoder.values, np.int64), None


def encode_values(program: Values, values: Values) -> tuple[bytes | None, Refusal | None]:
    """The bytes of a message, or why its flat values are refused."""
    encoder = _Encoder(program.tolist(), values.tolist())
    try:
        return encoder.message(), None
    except _Refused as refused:
        return None, (int(refused.fault), refused.found, tuple(encoder.path))


class _Refused(Exception):
    """Ends the coding of a message."""

    def __init__(self, fault: CodecFault, found: int) -> None:
        self.fault, self.found = fault, found


def _allowed(program: list[int], node: int, value: int) -> bool:
    """Whether a value is in the root of an INTEGER, and in one of its allowed ranges if there are some."""
    low, high, _, _, n_ranges = program[node + 1 : node + 6]
    ranges = program[node + 6 : node + 6 + 2 * n_ranges]
    return low <= value <= high and (
        not ranges or any(a <= value <= b for a, b in zip(ranges[::2], ranges[1::2], strict=True))
    )


class _Coder(ABC):
    """Follows a program: what reading and writing have in common."""

    def __init__(self, program: list[int]) -> None:
        self.program = program
        self.values: list[int] = []
        self.path: list[int] = []

    @abstractmethod
    def node(self, node: int, slot: int) -> None:
        """The type at an address, with the row that begins at a slot."""

    @abstractmethod
    def open(self, node: int, slot: int) -> None:
        """Open type (11.2); of an unknown one, its octets."""

    def alternative(self, node: int, slot: int, index: int) -> None:
        """The chosen alternative of a CHOICE (23): one of the root, an addition, or an unknown addition."""
        n, _, additions = self.program[node + 1 : node + 4]
        self.path.append(index)
        if index < n:
            self.node(self.program[node + 4 + index], slot + 1)
        else:
            known = index < n + additions
            self.open(self.program[node + 4 + index] if known else self.program[1], slot + 1)
        self.path.pop()

    def wrapped(self, node: int, slot: int) -> None:
        """Identifier and open type."""
        id_type, n = self.program[node + 1 : node + 3]
        self.node(id_type, slot)
        contents = self.program[node + 3 : node + 3 + 2 * n]
        index = contents[::2].index(self.values[slot]) if self.values[slot] in contents[::2] else n
        self.path.append(index)
        self.open(contents[2 * index + 1] if index < n else self.program[1], slot + 1)
        self.path.pop()


class _Decoder(_Coder):
    """Reads bits along a program."""

    def __init__(self, program: list[int], data: bytes) -> None:
        super().__init__(program)
        self.data = data
        self.position, self.end = 0, 8 * len(data)

    def message(self) -> None:
        """Decode all: a complete encoding is a whole number of octets, at least one (11.1)."""
        root, _, width = self.program[:3]
        self.node(root, self.reserve(width))
        rest = self.end - self.position
        if rest >= 8 and (rest > 8 or self.position):
            raise _Refused(CodecFault.TRAILING, rest // 8)
        if self.take(rest):
            raise _Refused(CodecFault.PADDING, rest)

    def take(self, bits: int) -> int:
        """The next bits as an unsigned number."""
        if bits > self.end - self.position:
            raise _Refused(CodecFault.TRUNCATED, self.end - self.position)
        first, self.position = self.position, self.position + bits
        octets = self.data[first >> 3 : (self.position + 7) >> 3]
        return (int.from_bytes(octets) >> (-self.position % 8)) & ((1 << bits) - 1)

    def reserve(self, n: int) -> int:
        """Start of n new slots, of value 0."""
        start = len(self.values)
        self.values += [0] * n
        return start

    def length(self) -> int:
        """General length determinant (11.9.3.5 to 11.9.3.8)."""
        if not self.take(1):
            return self.take(7)
        if self.take(1):
            raise _Refused(CodecFault.FRAGMENTED, 0)
        length = self.take(14)
        if length < 128:
            raise _Refused(CodecFault.LONGER, length)
        return length

    def small(self) -> int:
        """Normally small number below 64 (11.6)."""
        if self.take(1):
            raise _Refused(CodecFault.ADDITIONS, 0)
        return self.take(6)

    def open(self, node: int, slot: int) -> None:
        """Contents of an open type (11.2); of an unknown one, its octets."""
        octets = self.length()
        if octets == 0:
            raise _Refused(CodecFault.OPEN_LENGTH, octets)
        if 8 * octets > self.end - self.position:
            raise _Refused(CodecFault.TRUNCATED, self.end - self.position)
        if node == self.program[1]:
            self.rows(node, slot, octets)
            return
        outer, first = self.end, self.position
        self.end = first + 8 * octets
        self.node(node, slot)
        rest = self.end - self.position
        if rest >= 8 and (rest > 8 or self.position > first):
            raise _Refused(CodecFault.OPEN_LENGTH, octets)
        if self.take(rest):
            raise _Refused(CodecFault.PADDING, rest)
        self.end = outer

    def rows(self, node: int, slot: int, count: int) -> None:
        """Elements of a list."""
        element, width, least = self.program[node + 6 : node + 9]
        if count * least > self.end - self.position:
            raise _Refused(CodecFault.TRUNCATED, self.end - self.position)
        start = self.reserve(count * width) if count else 0
        self.values[slot], self.values[slot + 1] = count, start
        for row in range(count):
            self.path.append(row)
            self.node(element, start + row * width)
            self.path.pop()

    def node(self, node: int, slot: int) -> None:
        """Decode the type at an address into the row that begins at a slot."""
        _DECODING_STEPS[self.program[node]](self, node, slot)

    def integer(self, node: int, slot: int) -> None:
        """INTEGER (13), and BOOLEAN and ENUMERATED as one."""
        low, _, bits, extensible = self.program[node + 1 : node + 5]
        if extensible and self.take(1):
            octets = self.length()
            if not 1 <= octets <= 8:
                raise _Refused(CodecFault.WIDE_INTEGER, octets)
            value = self.take(8 * octets)
            value -= (value >> (8 * octets - 1)) << (8 * octets)
            if octets != _octets(value) or _allowed(self.program, node, value):
                raise _Refused(CodecFault.LONGER, value)
        else:
            value = low + self.take(bits)
            if not _allowed(self.program, node, value):
                raise _Refused(CodecFault.RANGE, value)
        self.values[slot] = value

    def enumerated(self, node: int, slot: int) -> None:
        """Extensible ENUMERATED (14)."""
        n, bits = self.program[node + 1 : node + 3]
        self.values[slot] = self.index(n, bits, extensible=True)

    def index(self, n: int, bits: int, extensible: bool) -> int:
        """Number of an alternative; n in the root, and from n on additions."""
        if extensible and self.take(1):
            return n + self.small()
        index = self.take(bits)
        if index >= n:
            raise _Refused(CodecFault.RANGE, index)
        return index

    def list(self, node: int, slot: int) -> None:
        """SEQUENCE OF (20), BIT STRING (16), OCTET STRING (17)."""
        low, high, bits, extensible, largest = self.program[node + 1 : node + 6]
        if extensible and self.take(1):
            count = self.length()
            if low <= count <= high:
                raise _Refused(CodecFault.LONGER, count)
        else:
            count = low + self.take(bits)
            if count > high:
                raise _Refused(CodecFault.COUNT, count)
        if count > largest:
            raise _Refused(CodecFault.COUNT, count)
        self.rows(node, slot, count)

    def sequence(self, node: int, slot: int) -> None:
        """SEQUENCE (19)."""
        n_fields, additions, extension, n_flags = self.program[node + 1 : node + 5]
        extended = additions >= 0 and self.take(1)
        flags = self.take(n_flags)
        for field in range(n_fields):
            kind, offset, address, default = self.program[node + 5 + 4 * field : node + 9 + 4 * field]
            self.path.append(field)
            if kind != NodeKind.MANDATORY:
                n_flags -= 1
                present = (flags >> n_flags) & 1
                if kind == NodeKind.DEFAULT:
                    self.values[slot + offset] = default
                else:
                    self.values[slot + offset - 1] = present
                    if (kind == NodeKind.PRESENT and not present) or (kind == NodeKind.ABSENT and present):
                        raise _Refused(CodecFault.PRESENCE, present)
            if kind == NodeKind.MANDATORY or present:
                self.node(address, slot + offset)
                if kind == NodeKind.DEFAULT and self.values[slot + offset] == default:
                    raise _Refused(CodecFault.LONGER, default)
            self.path.pop()
        if extended:
            self.additions(node, slot, n_fields, additions, slot + extension)

    def additions(self, node: int, slot: int, n_fields: int, known: int, extension: int) -> None:
        """Extension additions of a sequence (19.7 to 19.9)."""
        n = 1 + self.small()
        flags = self.take(n)
        if not flags:
            raise _Refused(CodecFault.NO_ADDITION, n)
        unknown = self.reserve(3 * (n - known)) if n > known else 0
        self.values[extension], self.values[extension + 1] = n, unknown
        for addition in range(n):
            if not (flags >> (n - 1 - addition)) & 1:
                continue
            self.path.append(n_fields + addition)
            if addition < known:
                field = node + 5 + 4 * (n_fields + addition)
                address, place = self.program[field + 2], slot + self.program[field + 1]
            else:
                address, place = self.program[1], unknown + 3 * (addition - known) + 1
            self.values[place - 1] = 1
            self.open(address, place)
            self.path.pop()

    def choice(self, node: int, slot: int) -> None:
        """CHOICE (23)."""
        n, bits, additions = self.program[node + 1 : node + 4]
        index = self.index(n, bits, additions >= 0)
        self.values[slot] = index
        self.alternative(node, slot, index)


_DECODING_STEPS: dict[int, Callable[[_Decoder, int, int], None]] = {
    Op.INTEGER: _Decoder.integer,
    Op.ENUMERATED: _Decoder.enumerated,
    Op.LIST: _Decoder.list,
    Op.SEQUENCE: _Decoder.sequence,
    Op.CHOICE: _Decoder.choice,
    Op.WRAPPED: _Decoder.wrapped,
}


def _octets(value: int) -> int:
    """Octets of the shortest two's complement."""
    return (value if value >= 0 else ~value).bit_length() // 8 + 1


class _Encoder(_Coder):
    """Writes bits along a program."""

    def __init__(self, program: list[int], values: list[int]) -> None:
        super().__init__(program)
        self.values = values
        self.number, self.bits = 0, 0

    def message(self) -> bytes:
        """Encode all."""
        root, _, width = self.program[:3]
        if len(self.values) < width:
            raise _Refused(CodecFault.ROWS, len(self.values))
        self.node(root, 0)
        return self.octets()

    def octets(self) -> bytes:
        """What has been written, padded to whole octets, at least one."""
        n = max(1, (self.bits + 7) // 8)
        return (self.number << (8 * n - self.bits)).to_bytes(n)

    def put(self, number: int, bits: int) -> None:
        """Append bits."""
        self.number, self.bits = (self.number << bits) | number, self.bits + bits

    def length(self, length: int) -> None:
        """General length determinant (11.9.3.5 to 11.9.3.8)."""
        if length > LONGEST:
            raise _Refused(CodecFault.FRAGMENTED, length)
        if length < 128:
            self.put(length, 8)
        else:
            self.put(0x8000 | length, 16)

    def open(self, node: int, slot: int) -> None:
        """Open type (11.2)."""
        if node == self.program[1]:
            count = self.values[slot]
            if not 1 <= count <= LONGEST:
                raise _Refused(CodecFault.COUNT, count)
            self.length(count)
            self.rows(node, slot, count)
            return
        outer, self.number, self.bits = (self.number, self.bits), 0, 0
        self.node(node, slot)
        octets = self.octets()
        self.number, self.bits = outer
        self.length(len(octets))
        self.put(int.from_bytes(octets), 8 * len(octets))

    def rows(self, node: int, slot: int, count: int) -> None:
        """Elements of a list."""
        element, width = self.program[node + 6 : node + 8]
        start = self.values[slot + 1]
        if count and not 0 <= start <= len(self.values) - count * width:
            raise _Refused(CodecFault.ROWS, start)
        for row in range(count):
            self.path.append(row)
            self.node(element, start + row * width)
            self.path.pop()

    def node(self, node: int, slot: int) -> None:
        """Encode the row that begins at a slot as the type at an address."""
        _ENCODING_STEPS[self.program[node]](self, node, slot)

    def integer(self, node: int, slot: int) -> None:
        """INTEGER (13), and BOOLEAN and ENUMERATED as one."""
        low, _, bits, extensible = self.program[node + 1 : node + 5]
        value = self.values[slot]
        if _allowed(self.program, node, value):
            self.put(value - low, bits + extensible)
        elif extensible:
            octets = _octets(value)
            self.put(1, 1)
            self.length(octets)
            self.put(value & ((1 << (8 * octets)) - 1), 8 * octets)
        else:
            raise _Refused(CodecFault.RANGE, value)

    def enumerated(self, node: int, slot: int) -> None:
        """Extensible ENUMERATED (14)."""
        n, bits = self.program[node + 1 : node + 3]
        self.index(self.values[slot], n, bits, extensible=True)

    def index(self, index: int, n: int, bits: int, extensible: bool) -> None:
        """Number of an alternative; n in the root, and from n on additions."""
        if not 0 <= index < n + 64 * extensible:
            raise _Refused(CodecFault.RANGE, index)
        if index < n:
            self.put(index, bits + extensible)
        else:
            self.put(0x80 | (index - n), 8)

    def list(self, node: int, slot: int) -> None:
        """SEQUENCE OF (20), BIT STRING (16), OCTET STRING (17)."""
        low, high, bits, extensible, largest = self.program[node + 1 : node + 6]
        count = self.values[slot]
        if not 0 <= count <= largest or not (extensible or low <= count <= high):
            raise _Refused(CodecFault.COUNT, count)
        if low <= count <= high:
            self.put(count - low, bits + extensible)
        else:
            self.put(1, 1)
            self.length(count)
        self.rows(node, slot, count)

    def flag(self, slot: int) -> int:
        """A slot of presence."""
        if self.values[slot] not in (0, 1):
            raise _Refused(CodecFault.PRESENCE, self.values[slot])
        return self.values[slot]

    def sequence(self, node: int, slot: int) -> None:
        """SEQUENCE (19)."""
        n_fields, additions, extension = self.program[node + 1 : node + 4]
        fields = [self.program[node + 5 + 4 * field : node + 9 + 4 * field] for field in range(n_fields)]
        present = []
        for field, (kind, offset, _, default) in enumerate(fields):
            self.path.append(field)
            present.append(1)
            if kind == NodeKind.DEFAULT:
                present[-1] = int(self.values[slot + offset] != default)
            elif kind != NodeKind.MANDATORY:
                present[-1] = self.flag(slot + offset - 1)
                if (kind == NodeKind.PRESENT and not present[-1]) or (kind == NodeKind.ABSENT and present[-1]):
                    raise _Refused(CodecFault.PRESENCE, present[-1])
            self.path.pop()
        if additions >= 0:
            self.put(int(self.values[slot + extension] != 0), 1)
        for field, (kind, *_) in enumerate(fields):
            if kind != NodeKind.MANDATORY:
                self.put(present[field], 1)
        for field, (_, offset, address, _) in enumerate(fields):
            if present[field]:
                self.path.append(field)
                self.node(address, slot + offset)
                self.path.pop()
        if additions >= 0:
            self.additions(node, slot, n_fields, additions, slot + extension)

    def additions(self, node: int, slot: int, n_fields: int, known: int, extension: int) -> None:
        """Extension additions of a sequence (19.7 to 19.9)."""
        n, unknown = self.values[extension : extension + 2]
        if not 0 <= n <= 64:
            raise _Refused(CodecFault.COUNT, n)
        if n > known and not 0 <= unknown <= len(self.values) - 3 * (n - known):
            raise _Refused(CodecFault.ROWS, unknown)
        places = []
        for addition in range(max(n, known)):
            self.path.append(n_fields + addition)
            if addition < known:
                field = node + 5 + 4 * (n_fields + addition)
                address, place = self.program[field + 2], slot + self.program[field + 1]
            else:
                address, place = self.program[1], unknown + 3 * (addition - known) + 1
            if self.flag(place - 1):
                if addition >= n:
                    raise _Refused(CodecFault.PRESENCE, 1)
                places.append((addition, address, place))
            self.path.pop()
        if not n:
            return
        if not places:
            raise _Refused(CodecFault.NO_ADDITION, n)
        self.put(n - 1, 7)
        self.put(sum(1 << (n - 1 - addition) for addition, _, _ in places), n)
        for addition, address, place in places:
            self.path.append(n_fields + addition)
            self.open(address, place)
            self.path.pop()

    def choice(self, node: int, slot: int) -> None:
        """CHOICE (23)."""
        n, bits, additions = self.program[node + 1 : node + 4]
        index = self.values[slot]
        self.index(index, n, bits, additions >= 0)
        self.alternative(node, slot, index)


_ENCODING_STEPS: dict[int, Callable[[_Encoder, int, int], None]] = {
    Op.INTEGER: _Encoder.integer,
    Op.ENUMERATED: _Encoder.enumerated,
    Op.LIST: _Encoder.list,
    Op.SEQUENCE: _Encoder.sequence,
    Op.CHOICE: _Encoder.choice,
    Op.WRAPPED: _Encoder.wrapped,
}
