"""Reading published pickles without executing anything.

A pickle is a program for a small stack machine whose opcodes may import and call things. The
machine here has only the opcodes that build plain data. The five names that the published files
mention are tokens to it: "calling" one makes a value of this module after its arguments were
checked, and everything else is refused. No foreign code is looked up, imported or called.
"""

import math
import pickletools
from collections.abc import Callable, Iterator
from gzip import GzipFile
from typing import IO, Any, NamedTuple, NoReturn, cast

import numpy as np
from numpy.typing import NDArray

from magical.errors import UnsafeFileError

# Bounds far above what the largest published file needs: 17,500 opcodes, 442,368 bytes an item,
# hardly any bytes that are not consumed at once.
MAX_OPCODES = 200_000
MAX_ITEM = 1 << 20  # bytes of one string, array or line
MAX_HELD = 16 << 20  # bytes of strings and byte strings kept at one time
MAX_KEPT = 64 << 20  # bytes of arrays after they were reduced

Reduce = Callable[[NDArray[Any]], NDArray[Any]]


class Name(NamedTuple):
    """A token for something that a pickle mentions."""

    module: str
    name: str

    def __str__(self) -> str:
        return f"{self.module}.{self.name}"


DTYPE = Name("numpy", "dtype")
NDARRAY = Name("numpy", "ndarray")
RECONSTRUCT = Name("numpy.core.multiarray", "_reconstruct")
ORDERED_DICT = Name("collections", "OrderedDict")
RECORD = Name("milbench.baselines.saved_trajectories", "MILBenchTrajectory")
ALLOWED = (DTYPE, NDARRAY, RECONSTRUCT, ORDERED_DICT, RECORD)
DTYPES = {"u1": "|", "i8": "<", "f8": "<", "f4": "<"}  # code: byte order


class Record(NamedTuple):
    """The published files' named tuple."""

    acts: Any
    obs: Any
    rews: Any
    infos: Any


class _Bytes:
    """Bytes on their way into an array; gone once they are in it."""

    def __init__(self, data: bytes) -> None:
        self.data: bytes | None = data


class _DType:
    def __init__(self, code: str) -> None:
        self.code = code


class Array:
    """An array, or (`values` None) the promise of one."""

    values: NDArray[Any] | None = None


class _Reader:
    """What pickletools reads from: one item at a time is bounded."""

    def __init__(self, file: IO[bytes] | GzipFile) -> None:
        self._file = file

    def read(self, size: int) -> bytes:
        if size > MAX_ITEM:
            raise ValueError(f"an item of {size} bytes, more than {MAX_ITEM}")
        return self._file.read(size)

    def readline(self) -> bytes:
        return self._file.readline(MAX_ITEM)

    def tell(self) -> int:
        return self._file.tell()


def load(file: IO[bytes] | GzipFile, reduce: Reduce) -> Any:
    """The data of a pickle: None, bool, int, float, str, list, tuple, dict, `Array`, `Record`.

    `reduce` is applied to every array as it is read, so that large ones need not be kept.

    Raises:
        UnsafeFileError: anything else is in it, or it is damaged.
    """
    machine, reader = _Machine(reduce), _Reader(file)
    position: int | None = 0
    for count, (opcode, argument, position) in enumerate(_opcodes(reader)):
        if count > MAX_OPCODES:
            _refuse(position, f"more than {MAX_OPCODES} opcodes")
        try:
            machine.do(opcode.name, argument)
        except (IndexError, KeyError, TypeError, ValueError) as error:
            _refuse(position, f"{opcode.name}: {error}", error)
    if reader.read(1):
        _refuse(position, "more data after the end")
    return machine.result()


def _opcodes(reader: _Reader) -> Iterator[tuple[Any, Any, int | None]]:
    try:
        yield from pickletools.genops(cast("IO[bytes]", reader))
    except ValueError as error:
        _refuse(reader.tell(), f"damaged: {error}", error)


def _refuse(position: int | None, what: str, cause: Exception | None = None) -> NoReturn:
    shown = what.encode("unicode_escape").decode()[:300]  # what a pickle says goes to a terminal
    raise UnsafeFileError(f"refused at byte {position}: {shown}; nothing was executed") from cause


class _Machine:
    """The stack, the marks on it, and the memo."""

    def __init__(self, reduce: Reduce) -> None:
        self._reduce = reduce
        self._stack: list[Any] = []
        self._marks: list[int] = []
        self._memo: dict[int, Any] = {}
        self._held = 0
        self._kept = 0

    def do(self, opcode: str, argument: Any) -> None:
        """Carry out one opcode; raises ValueError for one that the machine lacks."""
        if opcode in _IGNORED:
            return
        if opcode in _CONSTANTS:
            self._stack.append(_CONSTANTS[opcode]())
        elif opcode in _PUSHES:
            self._push(argument)
        elif opcode in _GETS:
            self._stack.append(self._memo[argument])
        elif opcode in _PUTS:
            self._memo[argument] = self._stack[-1]
        elif opcode in _ACTS:
            _ACTS[opcode](self, argument)
        else:
            raise ValueError("not among the opcodes of plain data")

    def result(self) -> Any:
        """What is left at the end."""
        if len(self._stack) != 1 or self._marks:
            _refuse(None, f"{len(self._stack)} values left, expected 1")
        return self._stack[0]

    def _push(self, argument: Any) -> None:
        if isinstance(argument, str | bytes):
            self._held += len(argument)
            if self._held > MAX_HELD:
                raise ValueError(f"more than {MAX_HELD} bytes that belong to no array")
        self._stack.append(_Bytes(argument) if isinstance(argument, bytes) else argument)

    def _memoize(self, _: Any) -> None:
        self._memo[len(self._memo)] = self._stack[-1]

    def _mark(self, _: Any) -> None:
        self._marks.append(len(self._stack))

    def _pop_mark(self) -> list[Any]:
        start = self._marks.pop()
        items = self._stack[start:]
        del self._stack[start:]
        return items

    def _pop(self, kind: type) -> Any:
        if self._marks and len(self._stack) <= self._marks[-1]:
            raise ValueError("nothing to take")
        value = self._stack.pop()
        if type(value) is not kind:
            raise ValueError(f"expected {kind.__name__}, found {type(value).__name__}")
        return value

    def _tuple(self, _: Any) -> None:
        self._stack.append(tuple(self._pop_mark()))

    def _tuple_of(self, count: int) -> None:
        if len(self._stack) - (self._marks[-1] if self._marks else 0) < count:
            raise ValueError("nothing to take")
        items = tuple(self._stack[-count:])
        del self._stack[-count:]
        self._stack.append(items)

    def _append(self, items: list[Any]) -> None:
        target = self._stack[-1]
        if type(target) is not list:
            raise ValueError(f"appending to {type(target).__name__}")
        target.extend(items)

    def _set(self, items: list[Any]) -> None:
        target = self._stack[-1]
        keys, values = items[::2], items[1::2]
        if type(target) is not dict or not all(type(key) is str for key in keys):
            raise ValueError(f"setting items of {type(target).__name__}, or keys that are no text")
        target.update(zip(keys, values, strict=True))

    def _global(self, argument: str) -> None:
        self._stack.append(_allowed(*argument.split(" ", 1)))

    def _stack_global(self, _: Any) -> None:
        name, module = self._pop(str), self._pop(str)
        self._stack.append(_allowed(module, name))

    def _call(self, _: Any) -> None:
        arguments, name = self._pop(tuple), self._pop(Name)
        if name == ORDERED_DICT and not arguments:
            self._stack.append({})
        elif name == DTYPE and len(arguments) == 3 and arguments[0] in DTYPES:
            self._stack.append(_DType(arguments[0]))
        elif name == RECONSTRUCT and len(arguments) == 3 and arguments[0] == NDARRAY:
            self._stack.append(Array())
        else:
            raise ValueError(f"calling {name} with {len(arguments)} arguments of another kind")

    def _new(self, _: Any) -> None:
        arguments, name = self._pop(tuple), self._pop(Name)
        if name != RECORD or len(arguments) != len(Record._fields):
            raise ValueError(f"making {name} of {len(arguments)} arguments")
        self._stack.append(Record(*arguments))

    def _build(self, _: Any) -> None:
        state, target = self._pop(tuple), self._stack[-1]
        if type(target) is Array and target.values is None:
            target.values = self._reduce(self._array(*state))
            self._kept += target.values.nbytes
            if self._kept > MAX_KEPT:
                raise ValueError(f"arrays of more than {MAX_KEPT} bytes")
        elif type(target) is not _DType or state[1:5] != (DTYPES[target.code], None, None, None):
            raise ValueError(f"changing the state of {type(target).__name__}")

    def _array(self, version: Any, shape: Any, dtype: Any, fortran: Any, held: Any) -> NDArray[Any]:
        if version != 1 or fortran is not False or type(dtype) is not _DType:
            raise ValueError("an array of another format")
        if type(shape) is not tuple or len(shape) > 4 or any(type(n) is not int for n in shape):
            raise ValueError("an array's shape that is none")
        if type(held) is not _Bytes or held.data is None:
            raise ValueError("an array without bytes of its own")
        kind = np.dtype(DTYPES[dtype.code] + dtype.code)
        if min(shape, default=0) < 0 or math.prod(shape) * kind.itemsize != len(held.data):
            raise ValueError(f"an array of another size than its {len(held.data)} bytes")
        values = np.frombuffer(held.data, kind).reshape(shape)
        self._held -= len(held.data)
        held.data = None
        return values


def _allowed(module: str, name: str) -> Name:
    mentioned = Name(module, name)
    if mentioned not in ALLOWED:
        raise ValueError(f"it names {mentioned}, expected only {', '.join(map(str, ALLOWED))}")
    return mentioned


_IGNORED = frozenset({"PROTO", "FRAME", "STOP"})
_CONSTANTS: dict[str, Callable[[], Any]] = {
    "NONE": lambda: None,
    "NEWTRUE": lambda: True,
    "NEWFALSE": lambda: False,
    "EMPTY_LIST": list,
    "EMPTY_TUPLE": tuple,
    "EMPTY_DICT": dict,
}
_NUMBERS = ("BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT")
_TEXTS = ("SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8")
_PUSHES = frozenset({*_NUMBERS, *_TEXTS, "SHORT_BINBYTES", "BINBYTES", "BINBYTES8"})
_GETS = frozenset({"BINGET", "LONG_BINGET"})
_PUTS = frozenset({"BINPUT", "LONG_BINPUT"})
_ACTS: dict[str, Callable[[_Machine, Any], None]] = {
    "MEMOIZE": _Machine._memoize,
    "MARK": _Machine._mark,
    "TUPLE": _Machine._tuple,
    "TUPLE1": lambda machine, _: machine._tuple_of(1),
    "TUPLE2": lambda machine, _: machine._tuple_of(2),
    "TUPLE3": lambda machine, _: machine._tuple_of(3),
    "APPEND": lambda machine, _: machine._append([machine._stack.pop()]),
    "APPENDS": lambda machine, _: machine._append(machine._pop_mark()),
    "SETITEM": lambda machine, _: machine._set([machine._stack.pop(-2), machine._stack.pop()]),
    "SETITEMS": lambda machine, _: machine._set(machine._pop_mark()),
    "GLOBAL": _Machine._global,
    "STACK_GLOBAL": _Machine._stack_global,
    "REDUCE": _Machine._call,
    "NEWOBJ": _Machine._new,
    "BUILD": _Machine._build,
}
