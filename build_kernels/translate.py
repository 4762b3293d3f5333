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
Translate kernels from Python to C++20.

A function becomes a template whose arguments are `auto`, so the C++ compiler works out all types.
What depends on None or on lanes becomes `if constexpr`. Arithmetic on constants is done here, by
Python. The code builds on runtime.hpp, and #line directives point to the Python source. The
subset of Python is described in docs/design.md; anything else raises `RejectedError`.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
import math
import operator
from pathlib import Path
import re
import sys
from types import ModuleType
from typing import Any, get_args, get_origin

import numpy as np

#: Modules whose counterparts are in runtime.hpp.
RUNTIME = ('four', 'jit', 'lanes')
#: The decorators of `rigid_body_ros.kernels.jit` that mark functions.
MARKS = {'inlined', 'internal', 'njit', 'optional'}
#: The most parts of a tuple.
MOST_PARTS = 16
_PACKAGE = 'rigid_body_ros.kernels.'
_FOLDED = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
           ast.Div: operator.truediv, ast.FloorDiv: operator.floordiv, ast.Mod: operator.mod,
           ast.Pow: operator.pow, ast.BitAnd: operator.and_, ast.BitOr: operator.or_,
           ast.LShift: operator.lshift, ast.RShift: operator.rshift}
_OPERATORS = {ast.Add: '+', ast.Sub: '-', ast.Mult: '*', ast.BitAnd: '&', ast.BitOr: '|',
              ast.LShift: '<<', ast.RShift: '>>'}
_NAMED_OPERATORS = {ast.Div: 'quotient', ast.FloorDiv: 'floor_quotient', ast.Mod: 'modulo'}
_COMPARISONS = {ast.Eq: '==', ast.NotEq: '!=', ast.Lt: '<', ast.LtE: '<=', ast.Gt: '>',
                ast.GtE: '>='}
#: Functions of Python and numpy, and their counterparts.
_FUNCTIONS = {float: 'double', int: 'int64_t', np.int64: 'int64_t', abs: 'py::absolute',
              max: 'py::largest', min: 'py::least', len: 'py::length', round: 'py::rounded',
              math.sqrt: 'py::square_root', np.sqrt: 'py::square_root',
              math.copysign: 'py::with_sign', math.floor: 'py::floored_integer',
              np.floor: 'py::floored', np.rint: 'py::nearest', math.ldexp: 'py::scaled',
              math.frexp: 'py::parts_of', np.searchsorted: 'py::places_right'}
#: Keyword arguments that are understood, as text.
_KEYWORDS = {np.searchsorted: ["side='right'"]}
_TYPES = {'f8': 'double', 'i8': 'int64_t', 'b1': 'bool', 'u1': 'uint8_t'}
#: Words of C++, and macros and the namespace of runtime.hpp.
_RESERVED = """
    alignas alignof and asm auto bool case catch char class compl concept const constexpr default
    delete do double enum explicit export extern float friend goto inline int int64_t long mutable
    namespace new not operator or private protected public register requires short signed sizeof
    static struct switch template this throw try typedef typename union unsigned using virtual void
    volatile xor END FOLDED INLINED KERNEL LANES SUFFIX py
"""


class RejectedError(Exception):
    """What is outside the subset of Python, with its file and line."""


@dataclass(frozen=True)
class Symbol:
    """A number that only the compiler knows; no constant may depend on it."""

    text: str


def translated(modules: Iterable[ModuleType]) -> str:
    """Return the C++ header of the kernels in modules."""
    files = [Module(module) for module in modules]
    functions = {getattr(file.module, node.name): Function(node, file)
                 for file in files for node in file.nodes}
    effects = _with_effects(functions)
    bodies = [line for function in _callees_first(functions)
              for line in function.definition(effects)]
    return '\n'.join(['#pragma once', '#include "runtime.hpp"', 'namespace {', *_tuples(),
                      *_record_structures(), *(line for file in files
                                               for line in file.declarations()),
                      *bodies, '}  // namespace', ''])


def short_name(module: str) -> str:
    """Return the name of the namespace of a module."""
    return module.removeprefix(_PACKAGE)


def element_type(dtype: np.dtype[Any]) -> str:
    """Return the C++ type of the elements of an array."""
    if dtype.fields:
        return next(name for name, record in _records().items() if record is dtype)
    return _TYPES[dtype.str[1:]]


def _records() -> dict[str, np.dtype[Any]]:
    # Return the types of records that the kernels define, by name.
    return {name: value for module in [*sys.modules.values()]
            if module.__name__.startswith(_PACKAGE) for name, value in vars(module).items()
            if isinstance(value, np.dtype) and value.fields}


def _tuples() -> list[str]:
    lines = ['namespace py {']
    for count in range(1, MOST_PARTS + 1):
        names = [f'part{k}' for k in range(count)]
        kinds = ', '.join(f'T{k}' for k in range(count))
        lines.append(_structure(f'Tuple<{kinds}>', names))
    return [*lines, 'INLINED Tuple<double, int64_t> parts_of(double a) {',
            '  int exponent;',
            '  double fraction = __builtin_frexp(a, &exponent);',
            '  return {fraction, exponent};',
            '}', '}  // namespace py']


def _structure(name: str, fields: list[str]) -> str:
    # Plain members: compilers keep them in registers more readily than those of std::tuple.
    kinds = ', '.join(f'class T{k}' for k in range(len(fields)))
    members = ' '.join(f'T{k} {_safe(field)};' for k, field in enumerate(fields))
    parts = ' else '.join(f'if constexpr (K == {k}) return ({_safe(field)});'
                          for k, field in enumerate(fields))
    return (f'template <{kinds}> struct {name} {{ {members} '
            f'static constexpr int count = {len(fields)}; '
            f'template <int K> INLINED constexpr const auto &part() const {{ {parts} }} }};')


def _record_structures() -> Iterator[str]:
    # A record is read and written where it lies: its fields are references and arrays.
    for name, record in _records().items():
        members, values = [], []
        for field, (kind, offset, *_) in record.fields.items():
            base, shape = kind.subdtype or (kind, ())
            type_, place = _TYPES[base.str[1:]], f'place + {offset}'
            if shape:
                members.append(f'py::Array<{type_}, 1> {field};')
                values.append(f'{field}{{({type_} *)({place}), {{{shape[0]}}}}}')
            else:
                members.append(f'{type_} &{field};')
                values.append(f'{field}(*({type_} *)({place}))')
        yield (f"struct {name} {{ {' '.join(members)} "
               f'static constexpr int64_t record_size = {record.itemsize}; '
               f"INLINED explicit {name}(char *place) : {', '.join(values)} {{}} }};")


def _safe(name: str) -> str:
    return f'{name}_' if re.search(rf'\b{name}\b', _RESERVED) else name


def _literal(value: Any) -> str:
    if isinstance(value, (bool, np.bool_)):
        return str(bool(value)).lower()
    if isinstance(value, int):
        return f'{value}L'
    if math.isfinite(value):
        return repr(float(value))
    return '__builtin_nan("")' if value != value else f'{"-" * (value < 0)}__builtin_inf()'


def _names(node: ast.AST, *contexts: type) -> list[str]:
    return [each.id for each in ast.walk(node)
            if isinstance(each, ast.Name) and isinstance(each.ctx, contexts)]


class Module:
    """A module with kernels."""

    def __init__(self, module: ModuleType) -> None:
        self.module, self.name = module, short_name(module.__name__)
        self.path = Path(module.__file__)
        #: Arrays that functions here read, by their names in C++.
        self.arrays: dict[str, Any] = {}
        self.nodes = [node for node in ast.parse(self.path.read_bytes()).body
                      if isinstance(node, ast.FunctionDef) and MARKS & {
                          ast.unparse(each) for each in node.decorator_list}]

    def declarations(self) -> Iterator[str]:
        """Yield the structures of named tuples, and arrays."""
        yield f'namespace {self.name} {{'
        for name, value in vars(self.module).items():
            if hasattr(value, '_fields') and value.__module__ == self.module.__name__:
                yield _structure(name, value._fields)
        for name, array in self.arrays.items():
            values = ', '.join(map(_literal, array.ravel().tolist()))
            sizes = ', '.join(map(str, array.shape))
            yield f'constexpr double {name}_values[] = {{{values}}};'
            yield (f'constexpr py::Array<const double, {array.ndim}> {name}'
                   f'{{{name}_values, {{{sizes}}}}};')
        yield f'}}  // namespace {self.name}'

    def found(self, node: ast.expr) -> Any:
        """Return what a name, or an attribute of a module, stands for, or None."""
        if isinstance(node, ast.Name):
            builtins = vars(self.module)['__builtins__']
            return getattr(self.module, node.id, builtins.get(node.id))
        if isinstance(node, ast.Attribute):
            owner = self.found(node.value)
            return getattr(owner, node.attr, None) if isinstance(owner, ModuleType) else None
        return None

    def line(self, node: Any) -> str:
        """Return the directive that names the line of a statement."""
        return f'#line {node.lineno} "{self.path}"'

    def rejected(self, node: Any, text: str) -> RejectedError:
        """Return an error at a line."""
        return RejectedError(f'{self.path}:{node.lineno}: {text}')


def _with_effects(functions: dict[Any, Function]) -> set[Any]:
    # Return the functions that write to arrays, themselves or through others.
    found = {key for key, function in functions.items() if function.stores}
    while more := {key for key, function in functions.items()
                   if found & {*function.calls}} - found:
        found |= more
    return found


def _callees_first(functions: dict[Any, Function]) -> list[Function]:
    # C++ infers the type of a result only after the function is defined.
    found: dict[Any, Function] = {}

    def visit(key: Any) -> None:
        if key in functions and key not in found:
            for each in functions[key].calls:
                visit(each)
            found[key] = functions[key]
    for key in functions:
        visit(key)
    return [*found.values()]


class Function:
    """A function with its statements in C++."""

    def __init__(self, node: ast.FunctionDef, module: Module) -> None:
        self.node, self.module = node, module
        self._marks = {ast.unparse(each) for each in node.decorator_list}
        inner = [*ast.walk(node)]
        #: What it calls, and whether it writes to an array.
        self.calls = [module.found(each.func) for each in inner if isinstance(each, ast.Call)]
        self.stores = any(
            isinstance(each, (ast.Attribute, ast.Subscript)) and isinstance(each.ctx, ast.Store)
            for each in inner) or any(
            getattr(each, '__name__', '') == 'store' and short_name(each.__module__) in RUNTIME
            for each in self.calls)
        self._effects: set[Any] = set()
        self._lines: list[str] = []
        self._count = 0
        self._arguments = [each.arg for each in node.args.args]
        #: Those that registers hold when a function is called.
        self._small = {each.arg for each in node.args.args if _is_small(
            eval(ast.unparse(each.annotation), vars(module.module)))}
        #: Those that have to be copied, because they change.
        self._changed = {*self._arguments} & {*_names(node, ast.Store)} - self._small
        #: Names that are declared, in this block and those around it.
        self._scopes = [set(self._arguments)]
        self._locals = {*self._arguments, *_names(node, ast.Store)}

    def definition(self, effects: set[Any]) -> list[str]:
        """Return the definition; some functions have effects."""
        self._effects = effects
        return [f'namespace {self.module.name} {{', self.module.line(self.node),
                f'{self._head()} {{', *self._body(), '}', '}']

    def _head(self) -> str:
        if self.node.args.defaults or self.node.args.kwonlyargs or self.node.args.vararg:
            raise self.module.rejected(self.node, 'expected arguments without defaults')
        arguments = ', '.join(
            f"{'auto ' if name in self._small else 'const auto &'}{self._given(name)}"
            for name in self._arguments)
        word = 'INLINED' if self._marks & {'inlined', 'optional'} else 'inline'
        return f'{word} auto {_safe(self.node.name)}({arguments})'

    def _given(self, name: str) -> str:
        return f'given_{name}' if name in self._changed else _safe(name)

    def _body(self) -> list[str]:
        if 'optional' in self._marks:
            test = self._is_none(self._given(self._arguments[0]))
            self._emit(f'if constexpr ({test}) return py::None{{}}; else {{')
        for name in sorted(self._changed):
            self._emit(f'auto {_safe(name)} = {self._given(name)};')
        self._block(self.node.body, set())
        if 'optional' in self._marks:
            self._emit('}')
        return self._lines

    # Statements.

    def _emit(self, text: str) -> None:
        self._lines.append('  ' * len(self._scopes) + text)

    def _block(self, body: list[ast.stmt], live: set[str], names: Iterable[str] = ()) -> None:
        # Translate the statements of a block, after which the values of some names are live.
        self._scopes.append(set(names))
        for place, node in enumerate(body):
            rest = body[place + 1:]
            if not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
                self._lines.append(self.module.line(node))
            if isinstance(node, (ast.If, ast.For, ast.While)):
                self._declare(node, _live(rest, live))
            if isinstance(node, ast.If) and not node.orelse and self._is_static(node.test) \
                    and isinstance(node.body[-1], (ast.Return, ast.Continue, ast.Break)):
                # What follows may have no meaning if the condition holds.
                self._if_else(node.test, node.body, rest, live, live)
                break
            self._statement(node, _live(rest, live))
        self._scopes.pop()

    def _statement(self, node: ast.stmt, live: set[str]) -> None:
        translate = getattr(self, f'_do_{type(node).__name__.lower()}', None)
        if not translate:
            raise self._rejected(node)
        translate(node, live)

    def _rejected(self, node: Any, expected: str = '') -> RejectedError:
        text = ast.unparse(node).splitlines()[0]
        expected = expected or f'{type(node).__name__} is not in the subset of Python for kernels'
        return self.module.rejected(node, f'{expected}: {text}')

    def _do_pass(self, node: ast.Pass, live: set[str]) -> None:
        pass

    def _do_expr(self, node: ast.Expr, live: set[str]) -> None:
        if isinstance(node.value, ast.Call):
            self._emit(f'{self._value(node.value)};')
        elif not isinstance(node.value, ast.Constant):
            raise self._rejected(node)

    def _do_return(self, node: ast.Return, live: set[str]) -> None:
        self._emit(f'return {self._value(node.value)};' if node.value else 'return;')

    def _do_break(self, node: ast.Break, live: set[str]) -> None:
        self._emit('break;')

    def _do_continue(self, node: ast.Continue, live: set[str]) -> None:
        self._emit('continue;')

    def _do_augassign(self, node: ast.AugAssign, live: set[str]) -> None:
        target = self._target(node.target)
        value = self._operation(node, target, self._value(node.value))
        self._emit(f'{target} = {value};')

    def _do_assign(self, node: ast.Assign, live: set[str]) -> None:
        first, *others = node.targets
        if not others:
            self._assign_value(first, node.value)
        elif self._constant(node.value) is not None:
            for target in node.targets:
                self._assign_value(target, node.value)
        else:
            value = self._held(self._value(node.value))
            for target in node.targets:
                self._assign(target, value)

    def _assign_value(self, target: ast.expr, value: ast.expr) -> None:
        if isinstance(target, ast.Name):
            self._assign(target, self._value(value))
        elif not isinstance(target, ast.Tuple):
            self._emit(f'{self._target(target)} = {self._value(value)};')
        elif not isinstance(value, ast.Tuple) or any(
                isinstance(each, ast.Starred) for each in value.elts):
            is_kept = isinstance(value, ast.Name) and value.id not in _names(target, ast.Store)
            text = self._value(value)
            self._assign(target, text if is_kept else self._held(text))
        elif len(target.elts) != len(value.elts):
            raise self._rejected(target, f'expected {len(value.elts)} targets')
        else:
            self._assign_each(target.elts, value.elts)

    def _assign_each(self, targets: list[ast.expr], values: list[ast.expr]) -> None:
        # A value that is read after an earlier target has changed takes a variable, as in a swap.
        overlaps = any(_may_change(target, value) for k, target in enumerate(targets)
                       for value in values[k + 1:])
        if not overlaps:
            for target, value in zip(targets, values):
                self._assign_value(target, value)
            return
        for target, text in zip(targets, [self._held(self._value(value)) for value in values]):
            self._assign(target, text)

    def _held(self, value: str) -> str:
        # Return a variable with a value.
        self._count += 1
        self._emit(f'auto held_{self._count} = {value};')
        return f'held_{self._count}'

    def _assign(self, target: ast.expr, value: str) -> None:
        if isinstance(target, ast.Tuple):
            for place, each in enumerate(target.elts):
                if not (isinstance(each, ast.Name) and each.id == '_'):
                    self._assign(each, f'py::at<{place}>({value})')
        elif isinstance(target, ast.Name) and not self._is_declared(target.id):
            self._scopes[-1].add(target.id)
            self._emit(f'auto {_safe(target.id)} = {value};')
        else:
            self._emit(f'{self._target(target)} = {value};')

    def _target(self, node: ast.expr) -> str:
        if not isinstance(node, (ast.Attribute, ast.Name, ast.Subscript)):
            raise self._rejected(node)
        return self._value(node)

    def _is_declared(self, name: str) -> bool:
        return any(name in scope for scope in self._scopes)

    def _do_if(self, node: ast.If, live: set[str]) -> None:
        self._if_else(node.test, node.body, node.orelse, live, live)

    def _if_else(self, test: ast.expr, body: list[ast.stmt], orelse: list[ast.stmt],
                 live: set[str], live_after: set[str]) -> None:
        parts = test.values if isinstance(test, ast.BoolOp) and isinstance(
            test.op, ast.And) else [test]
        static = [part for part in parts if self._is_static(part)]
        dynamic = [part for part in parts if part not in static]
        if static and dynamic:
            if orelse or dynamic != parts[len(static):]:
                raise self._rejected(test, 'expected what is known to the compiler first, and '
                                           'no else')
            self._emit(f"if constexpr ({' && '.join(map(self._test, static))})")
            test = ast.BoolOp(ast.And(), dynamic) if len(dynamic) > 1 else dynamic[0]
            static = []
        self._emit(f"if {'constexpr ' if static else ''}({self._test(test)}) {{")
        self._block(body, live)
        if orelse:
            self._emit('} else {')
            self._block(orelse, live_after)
        self._emit('}')

    def _do_while(self, node: ast.While, live: set[str]) -> None:
        if node.orelse:
            raise self._rejected(node)
        self._emit(f'while ({self._test(node.test)}) {{')
        self._block(node.body, live | _live([node], live))
        self._emit('}')

    def _do_for(self, node: ast.For, live: set[str]) -> None:
        names = set(_names(node.target, ast.Store)) - {'_'}
        changed = {name for each in node.body for name in _names(each, ast.Store)}
        if node.orelse or names & (changed | live) or any(map(self._is_declared, names)):
            raise self._rejected(node, 'expected a loop without else, whose variable is used '
                                       'only there')
        live = live | _live([node], live)
        if isinstance(node.iter, ast.Call) and ast.unparse(node.iter.func) == 'range':
            self._for_range(node, live)
            return
        values = self._value(self._enumerated(node.iter))
        self._count += 1
        each = f'each_{self._count}'
        self._emit(f'for (const auto &{each} : py::elements({values})) {{')
        self._scopes.append(set())
        self._assign(node.target, each)
        self._block(node.body, live)
        self._scopes.pop()
        self._emit('}')

    def _for_range(self, node: ast.For, live: set[str]) -> None:
        if not isinstance(node.target, ast.Name) or node.iter.keywords:
            raise self._rejected(node)
        arguments = node.iter.args
        begin, stop, step = {1: (ast.Constant(0), *arguments, ast.Constant(1)),
                             2: (*arguments, ast.Constant(1)), 3: arguments}[len(arguments)]
        k, end = _safe(node.target.id), f'end_{self._count}'
        self._count += 1
        number = self._constant(step)
        test = f'py::in_range({k}, {end}, {self._value(step)})' if number is None else \
            f"{k} {'>' if number < 0 else '<'} {end}"
        self._emit(f'for (int64_t {k} = {self._value(begin)}, {end} = {self._value(stop)}; '
                   f'{test}; {k} += {self._value(step)}) {{')
        self._block(node.body, live, [node.target.id])
        self._emit('}')

    def _enumerated(self, node: ast.expr) -> ast.expr:
        # Return what a loop goes through, with the numbers of `enumerate`.
        if not (isinstance(node, ast.Call) and ast.unparse(node.func) == 'enumerate'):
            return node
        values, = node.args
        if not isinstance(values, ast.Tuple):
            raise self._rejected(node)
        return ast.Tuple([ast.Tuple([ast.Constant(k), value], ast.Load())
                          for k, value in enumerate(values.elts)], ast.Load())

    def _declare(self, node: ast.stmt, live: set[str]) -> None:
        # Declare what the blocks of a statement assign and what is live after it.
        names = {name for name in _names(node, ast.Store)
                 if name in live and not self._is_declared(name)}
        for name in sorted(names):
            kinds = [(tests, self._value(value)) for tests, value in _assigned(node, name)
                     if self._can_declare(value)]
            if not kinds:
                raise self.module.rejected(node, f'expected {name} to be assigned before this')
            self._declare_as(name, kinds)
            self._scopes[-1].add(name)

    def _can_declare(self, value: ast.expr) -> bool:
        return all(self._is_declared(name) for name in _names(value, ast.Load)
                   if name in self._locals)

    def _declare_as(self, name: str, kinds: list[tuple[list[ast.expr], str]]) -> None:
        self._count += 1
        kind = f'kind_{self._count}'
        choices = [(' && '.join(self._test(test) for test in tests if self._is_static(test)), text)
                   for tests, text in kinds]
        self._emit(f'auto {kind} = [&] {{  // for its type')
        for test, text in choices:
            self._emit(f'  if constexpr ({test or "true"}) return {text}; else')
        self._emit('  return py::None{};')
        self._emit('};')
        self._emit(f'py::Bare<decltype({kind}())> {_safe(name)};')

    # Expressions.

    def _value(self, node: ast.expr) -> str:
        constant = self._constant(node)
        if constant is not None:
            return _literal(constant)
        translate = getattr(self, f'_of_{type(node).__name__.lower()}', None)
        if not translate:
            raise self._rejected(node)
        return translate(node)

    def _constant(self, node: ast.expr) -> Any:
        # Return the number that an expression stands for, or None.
        if isinstance(node, ast.Constant):
            return node.value if isinstance(node.value, (bool, int, float)) else None
        if isinstance(node, (ast.Name, ast.Attribute)):
            found = self._global(node)
            return found if isinstance(found, (bool, int, float)) else None
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            number = self._constant(node.operand)
            return None if number is None else -number
        if isinstance(node, ast.BinOp):
            numbers = self._constant(node.left), self._constant(node.right)
            return None if None in numbers else _FOLDED[type(node.op)](*numbers)
        if isinstance(node, ast.Subscript) and isinstance(self._global(node.value), tuple):
            place = self._constant(node.slice)
            return None if place is None else self._global(node.value)[place]
        return None

    def _global(self, node: ast.expr) -> Any:
        # Return what a name of the module stands for, or None.
        return None if set(_names(node, ast.Load)) & self._locals else self.module.found(node)

    def _of_constant(self, node: ast.Constant) -> str:
        if node.value is None:
            return 'py::None{}'
        raise self._rejected(node)

    def _of_name(self, node: ast.Name) -> str:
        if node.id in self._locals:
            if not self._is_declared(node.id):
                raise self._rejected(node, 'expected a value on every path')
            return _safe(node.id)
        return self._reference(node, node.id)

    def _of_attribute(self, node: ast.Attribute) -> str:
        owner = self._global(node.value)
        if isinstance(owner, ModuleType):
            if owner.__name__.removeprefix(_PACKAGE) in RUNTIME:
                return f'{short_name(owner.__name__)}::{_safe(node.attr)}'
            return self._reference(node, node.attr)
        return f'{self._value(node.value)}.{_safe(node.attr)}'

    def _reference(self, node: ast.expr, name: str) -> str:
        # Return the name in C++ of what another module or this one defines.
        found = self._global(node)
        if isinstance(found, Symbol):
            return found.text
        if isinstance(found, tuple):
            return f"py::Tuple{{{', '.join(map(_literal, found))}}}"
        if isinstance(found, np.ndarray) and found.dtype == float:
            self.module.arrays[name] = found
            return f'{self.module.name}::{name}'
        home = getattr(found, '__module__', '')
        if not home.startswith(_PACKAGE):
            raise self._rejected(node, 'expected a kernel, a number, numbers or an array')
        return f'{short_name(home)}::{_safe(found.__name__)}'

    def _of_call(self, node: ast.Call) -> str:
        found = self._global(node.func)
        if found is None:
            raise self._rejected(node)
        target = _FUNCTIONS.get(found)
        keywords = [ast.unparse(each) for each in node.keywords]
        if keywords != (_KEYWORDS.get(found, []) if target else []):
            raise self._rejected(node)
        if getattr(found, '__name__', '') == 'scratch':
            return self._scratch(node)
        if getattr(found, '__name__', '') == 'has_lanes':
            return self._test(node)
        arguments = [self._argument(each) for each in node.args
                     if not isinstance(each, ast.Starred)]
        if target:
            return f"{target}({', '.join(arguments)})"
        target = self._value(node.func)
        if not hasattr(found, '_fields'):
            self._check_order(node.args)
        if hasattr(found, '_fields'):
            missing = found._fields[len(arguments):]
            arguments += [self._value(ast.Constant(found._field_defaults[name]))
                          for name in missing]
            return f"{target}{{{', '.join(arguments)}}}"
        if node.args and isinstance(node.args[-1], ast.Starred):
            rest = self._value(node.args[-1].value)
            arguments.append('rest...')
            return (f'py::apply([&](const auto &...rest) FOLDED {{ return '
                    f"{target}({', '.join(arguments)}); }}, {rest})")
        return f"{target}({', '.join(arguments)})"

    def _argument(self, node: ast.expr) -> str:
        text = self._value(node)
        is_slice = isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Slice)
        return text.replace('py::slice<', 'py::lent<', 1) if is_slice else text

    def _check_order(self, operands: list[ast.expr]) -> None:
        # Unlike Python, C++ evaluates operands in any order.
        for operand in operands:
            if any(isinstance(each, ast.Call) and self._global(each.func) in self._effects
                   for each in ast.walk(operand)) and any(
                    isinstance(each, (ast.Call, ast.Subscript))
                    for other in operands if other is not operand for each in ast.walk(other)):
                raise self._rejected(operand, 'expected a statement of its own')

    def _scratch(self, node: ast.Call) -> str:
        size = self._constant(node.args[0])
        if size is None or len(self._scopes) > 2:
            raise self._rejected(node, 'expected a constant size, outside of blocks')
        self._count += 1
        # A vector that lies in two cache lines takes longer.
        self._emit(f'alignas(64) double scratch_{self._count}[{size}];')
        return f'py::Array<double, 1>{{scratch_{self._count}, {{{size}}}}}'

    def _of_binop(self, node: ast.BinOp) -> str:
        self._check_order([node.left, node.right])
        return self._operation(node, self._value(node.left), self._value(node.right))

    def _operation(self, node: ast.BinOp | ast.AugAssign, left: str, right: str) -> str:
        kind = type(node.op)
        if kind in _OPERATORS:
            return f'({left} {_OPERATORS[kind]} {right})'
        if kind not in _NAMED_OPERATORS:
            raise self._rejected(node)
        return f'py::{_NAMED_OPERATORS[kind]}({left}, {right})'

    def _of_unaryop(self, node: ast.UnaryOp) -> str:
        if isinstance(node.op, ast.Not):
            return self._test(node)
        if not isinstance(node.op, ast.USub):
            raise self._rejected(node)
        return f'(-{self._value(node.operand)})'

    def _of_boolop(self, node: ast.BoolOp) -> str:
        return self._joined(node, [f'py::truth({self._value(each)})' for each in node.values])

    def _joined(self, node: ast.BoolOp, values: list[str]) -> str:
        return f"({(' && ' if isinstance(node.op, ast.And) else ' || ').join(values)})"

    def _of_compare(self, node: ast.Compare) -> str:
        if isinstance(node.ops[0], (ast.Is, ast.IsNot)):
            return self._test(node)
        middle = node.comparators[:-1]
        if any(isinstance(each, ast.Call) for value in middle for each in ast.walk(value)):
            raise self._rejected(node, 'expected no call in the middle of a comparison')
        if not all(type(each) in _COMPARISONS for each in node.ops):
            raise self._rejected(node)
        self._check_order([node.left, *node.comparators])
        values = [*map(self._value, [node.left, *node.comparators])]
        pairs = [f'({values[k]} {_COMPARISONS[type(each)]} {values[k + 1]})'
                 for k, each in enumerate(node.ops)]
        return pairs[0] if len(pairs) == 1 else f"({' && '.join(pairs)})"

    def _of_ifexp(self, node: ast.IfExp) -> str:
        test, one, other = self._test(node.test), self._value(node.body), self._value(node.orelse)
        if self._is_static(node.test):
            return (f'[&]() FOLDED {{ if constexpr ({test}) return {one}; '
                    f'else return {other}; }}()')
        return f'({test} ? {one} : {other})'

    def _of_tuple(self, node: ast.Tuple) -> str:
        if not any(isinstance(each, ast.Starred) for each in node.elts):
            return f"py::Tuple{{{', '.join(map(self._value, node.elts))}}}"
        return ' + '.join(self._value(each.value) if isinstance(each, ast.Starred)
                          else f'py::tuple({self._value(each)})' for each in node.elts)

    def _of_subscript(self, node: ast.Subscript) -> str:
        whole, index = self._value(node.value), node.slice
        if isinstance(index, ast.Slice):
            return self._slice(whole, index)
        places = index.elts if isinstance(index, ast.Tuple) else [index]
        if any(isinstance(place, ast.Slice) for place in places):
            return self._column(node, whole, places)
        number = self._constant(places[0])
        if len(places) > 1 or number is None:
            return f"py::at({', '.join([whole, *map(self._value, places)])})"
        if number < 0:
            raise self._rejected(node, 'expected an index from the start')
        return f'py::at<{number}>({whole})'

    def _slice(self, whole: str, index: ast.Slice) -> str:
        if index.step:
            raise self._rejected(index)
        begin, end = index.lower or ast.Constant(0), index.upper
        text = self._value(end) if end else 'py::END'
        if self._constant(begin) is not None and (not end or self._constant(end) is not None):
            return f'py::slice<{self._value(begin)}, {text}>({whole})'
        return f'py::slice({whole}, {self._value(begin)}, {text})'

    def _column(self, node: ast.Subscript, whole: str, places: list[ast.expr]) -> str:
        *before, part, last = places
        if not isinstance(part, ast.Slice):
            raise self._rejected(node, 'expected a slice only before the last index')
        if before:
            whole = f"py::at({', '.join([whole, *map(self._value, before)])})"
        return f'py::column({self._slice(whole, part)}, {self._value(last)})'

    # Conditions.

    def _is_static(self, node: ast.expr) -> bool:
        # Return whether the compiler knows a condition.
        if isinstance(node, ast.BoolOp):
            return all(map(self._is_static, node.values))
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return self._is_static(node.operand)
        if isinstance(node, ast.Call):
            return getattr(self._global(node.func), '__name__', '') == 'has_lanes'
        return isinstance(node, ast.Compare) and isinstance(node.ops[0], (ast.Is, ast.IsNot))

    def _is_none(self, value: str) -> str:
        return f'py::is_none<decltype({value})>'

    def _test(self, node: ast.expr) -> str:
        # Return a condition; unlike a value, a number will do.
        if isinstance(node, ast.BoolOp):
            return self._joined(node, [*map(self._test, node.values)])
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return f'!{self._test(node.operand)}'
        if not self._is_static(node):
            return self._value(node)
        if isinstance(node, ast.Call):
            return f'py::has_lanes<decltype({self._value(node.args[0])})>'
        if len(node.ops) > 1 or ast.unparse(node.comparators[0]) != 'None':
            raise self._rejected(node, 'expected a comparison with None')
        sign = '!' if isinstance(node.ops[0], ast.IsNot) else ''
        return sign + self._is_none(self._value(node.left))


def _is_small(hint: Any) -> bool:
    # Return whether an annotation stands for a number or a pair of numbers.
    numbers = get_args(hint) if get_origin(hint) is tuple else [hint]
    return len(numbers) <= 2 and all(each in (bool, float, int) for each in numbers)


def _may_change(target: ast.expr, value: ast.expr) -> bool:
    # Return whether an assignment may change a value; arrays may overlap.
    if set(_names(target, ast.Store)) & set(_names(value, ast.Load)):
        return True
    return any(isinstance(each, (ast.Attribute, ast.Subscript)) and isinstance(
        each.ctx, ast.Store) for each in ast.walk(target)) and any(
        isinstance(each, (ast.Attribute, ast.Call, ast.Subscript)) for each in ast.walk(value))


def _assigned(node: ast.stmt, name: str,
              tests: tuple[ast.expr, ...] = ()) -> Iterator[tuple[list[ast.expr], ast.expr]]:
    # Yield what is assigned to a name within a statement, and the conditions for it.
    if isinstance(node, ast.Assign) and any(
            isinstance(target, ast.Name) and target.id == name for target in node.targets):
        yield [*tests], node.value
    if isinstance(node, ast.If):
        opposite = ast.UnaryOp(ast.Not(), node.test)
        for each in node.body:
            yield from _assigned(each, name, (*tests, node.test))
        for each in node.orelse:
            yield from _assigned(each, name, (*tests, opposite))
    elif isinstance(node, (ast.For, ast.While)):
        for each in node.body:
            yield from _assigned(each, name, tests)


def _live(body: list[ast.stmt], after: set[str]) -> set[str]:
    # Return the names whose values statements may read before they assign them.
    live = set(after)
    for node in reversed(body):
        if isinstance(node, ast.If):
            live = (_live(node.body, live) | _live(node.orelse, live)
                    | set(_names(node.test, ast.Load)))
        elif isinstance(node, (ast.For, ast.While)):
            head = node.iter if isinstance(node, ast.For) else node.test
            targets = set(_names(node.target, ast.Store)) if isinstance(node, ast.For) else set()
            inner = _live(node.body, live | _live(node.body, live)) - targets
            live |= inner | set(_names(head, ast.Load))
        elif isinstance(node, ast.Return):
            live = set(_names(node, ast.Load))
        else:
            for target in getattr(node, 'targets', ()):
                live -= set(_names(target, ast.Store))
            live |= set(_names(node, ast.Load))
            if isinstance(node, ast.AugAssign):
                live |= set(_names(node.target, ast.Store))
    return live
