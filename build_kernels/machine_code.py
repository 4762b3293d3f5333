# Copyright 2026 The rigid_body_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
The machine code of kernels: one object file for each processor level.

numba types each function and generates its code for LLVM. Left alone it then optimises and links
function by function, for the processor at hand. Here every function keeps its raw code. All of it
is linked into one module, which LLVM optimises once for each level.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from levels import Level
from llvmlite import ir
import llvmlite.binding as llvm
from numba.core import cgutils, codegen, types
from numba.core.callconv import CPUCallConv
from numba.core.registry import cpu_target
from numba.core.runtime.context import NRTContext
from numba.np.arrayobj import populate_array
from signatures import DIMENSIONS, Part

_CONTEXT = cpu_target.target_context
_I64 = ir.IntType(64)
_SLOT = ir.LiteralStructType([ir.IntType(8).as_pointer(), ir.ArrayType(_I64, DIMENSIONS)])
#: Results of numba's types, in the table of the boundary.
_RESULTS = {types.int64: 'I', types.uint64: 'I', types.boolean: 'B', types.float64: 'F',
            types.none: '-'}
#: numba's names of functions of C, which are exact.
_IN_C = {'numba_frexp': 'frexp', 'numba_ldexp': 'ldexp'}
#: What the code may leave to the linker.
_EXTERNAL = {'memcpy', 'memset', 'fma', 'sqrt', *_IN_C.values()}


def keep_raw() -> None:
    """Make numba keep the code of each function as it is, without counts of references."""
    library, jit = codegen.CPUCodeLibrary, codegen.JITCPUCodegen

    def set_layout(self: Any, module: Any) -> None:
        module.data_layout = self._codegen._data_layout

    def finish(self: Any) -> None:
        self._raise_if_finalized()
        self._finalized = True
    library._optimize_functions, library.finalize = set_layout, finish
    codegen.JITCodeLibrary.get_pointer_to_function = lambda self, name: 0
    jit.set_env = lambda self, name, env: None  # it would write through that pointer
    # Kernels allocate nothing, so no array has a count.
    NRTContext.incref = NRTContext.decref = lambda self, builder, kind, value: None
    # The boundary needs only the status. What describes an exception has paths of this machine.
    CPUCallConv.set_static_user_exc = lambda self, builder, *rest, **more: None


class Module:
    """The code of kernels and of all functions that they call."""

    def __init__(self) -> None:
        self._libraries: list[Any] = []
        self._wrappers = ir.Module('wrappers')
        self._wrappers.data_layout = str(_CONTEXT.codegen()._data_layout)
        self._names: set[str] = set()

    def add(self, name: str, kernel: Any, arguments: tuple[Part, ...]) -> str:
        """Compile a kernel for a signature; return the kinds of its results."""
        kinds = tuple(part.kernel_type for part in arguments)
        kernel.compile(kinds)
        found = kernel.overloads[kinds]
        self._libraries.append(found.library)
        self._names.add(name)
        return self._wrap(name, found.fndesc, arguments)

    def linked(self) -> bytes:
        """Return all of the code as LLVM's bitcode, for no processor yet."""
        whole = llvm.parse_assembly('')
        for library in _in_order(self._libraries):
            module = llvm.parse_assembly(str(library._final_module))
            for function in module.functions:
                # LLVM drops functions that may be dropped and are not called yet.
                if not function.is_declaration and function.linkage in (
                        llvm.Linkage.external, llvm.Linkage.linkonce_odr):
                    function.linkage = 'weak_odr'
            whole.link_in(module)
        whole.link_in(llvm.parse_assembly(str(self._wrappers)))
        for found in (*whole.functions, *whole.global_variables):
            if not found.is_declaration and found.name not in self._names:
                found.linkage = 'internal'
            found.name = _IN_C.get(found.name, found.name)
        return whole.as_bitcode()

    def _wrap(self, name: str, described: Any, arguments: tuple[Part, ...]) -> str:
        # Write `int32 NAME(int64 *results, const slot *arguments)`.
        kernel = _CONTEXT.declare_function(self._wrappers, described)
        kind = ir.FunctionType(ir.IntType(32), [_I64.as_pointer(), _SLOT.as_pointer()])
        wrapper = ir.Function(self._wrappers, kind, name)
        builder = ir.IRBuilder(wrapper.append_basic_block())
        slots = _slots(builder, wrapper.args[1])
        status, value = _CONTEXT.call_conv.call_function(
            builder, kernel, described.restype, described.argtypes,
            [_value(builder, part, slots) for part in arguments])
        results = _results(builder, described.restype, value, wrapper.args[0])
        builder.ret(builder.zext(status.is_error, ir.IntType(32)))
        return results


def _in_order(libraries: list[Any]) -> list[Any]:
    # Return libraries and those that they need, each once, after those.
    seen: set[int] = set()
    order: list[Any] = []

    def visit(library: Any) -> None:
        if id(library) not in seen:
            seen.add(id(library))
            for other in library._linking_libraries:
                visit(other)
            order.append(library)
    for library in libraries:
        visit(library)
    return order


def _slots(builder: Any, pointer: Any) -> Iterator[Any]:
    # Yield data and shape of one slot after another.
    place = 0
    while True:
        slot = builder.load(builder.gep(pointer, [ir.Constant(_I64, place)]))
        yield builder.extract_value(slot, 0), [
            builder.extract_value(slot, (1, k)) for k in range(DIMENSIONS)]
        place += 1


def _value(builder: Any, part: Part, slots: Iterator[Any]) -> Any:
    # Return an argument as numba represents it.
    if part.kind == '-':
        return _CONTEXT.get_dummy_value()
    if part.kind == '(':
        return _CONTEXT.make_tuple(builder, part.kernel_type,
                                   [_value(builder, each, slots) for each in part.parts])
    data, shape = next(slots)
    if part.kind == 'I':
        return shape[0]
    if part.kind == 'B':
        return builder.trunc(shape[0], ir.IntType(1))
    if part.kind == 'F':
        return builder.bitcast(shape[0], ir.DoubleType())
    return _array(builder, part, data, shape[:len(part.dimensions)])


def _array(builder: Any, part: Part, data: Any, shape: list[Any]) -> Any:
    array = _CONTEXT.make_array(part.kernel_type)(_CONTEXT, builder)
    strides = [ir.Constant(_I64, part.size)]
    for size in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], size))
    element = _CONTEXT.get_data_type(part.kernel_type.dtype)
    populate_array(array, builder.bitcast(data, element.as_pointer()), shape, strides,
                   ir.Constant(_I64, part.size), None)
    return array._getvalue()


def _results(builder: Any, kind: Any, value: Any, target: Any) -> str:
    if kind == types.none:
        return '-'
    kinds = list(kind) if isinstance(kind, types.BaseTuple) else [kind]
    values = cgutils.unpack_tuple(builder, value) if isinstance(kind, types.BaseTuple) else [value]
    for place, (each, number) in enumerate(zip(kinds, values)):
        bits = (builder.bitcast(number, _I64) if each == types.float64
                else builder.zext(number, _I64) if number.type != _I64 else number)
        builder.store(bits, builder.gep(target, [ir.Constant(_I64, place)]))
    return ''.join(_RESULTS[each] for each in kinds)


def compiled(code: bytes, level: Level) -> bytes:
    """Return bitcode as an object file for a processor level."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    module = llvm.parse_bitcode(code)
    for function in module.functions:
        if not function.is_declaration and function.linkage == llvm.Linkage.external:
            function.name += level.suffix
    module.triple = level.triple
    machine = llvm.Target.from_triple(level.triple).create_target_machine(
        cpu=level.processor, opt=3, reloc='pic', codemodel='default')
    module.data_layout = str(machine.target_data)
    module.verify()
    builder = codegen.create_pass_builder(machine, opt=3, loop_vectorize=True, slp_vectorize=False)
    builder.getModulePassManager().run(module, builder)
    unknown = {function.name for function in module.functions if function.is_declaration
               and not function.name.startswith('llvm.')} - _EXTERNAL
    if unknown:
        raise ValueError(f'the kernels need {unknown}: expected code without numba')
    return machine.emit_object(module)
