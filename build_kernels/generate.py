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
Write the kernels in C++, and compile them: `generate.py FOLDER LEVEL... -- COMPILER...`.

FOLDER gets kernels.hpp, which `translate.py` writes, a file for each group of signatures, an
object for each of those and each processor level, and table.h, which describes the kernels to the
boundary.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

from levels import Level, LEVELS
from modules import load
from signatures import Part, results, signatures, VARIABLES
from translate import RejectedError, short_name, translated

HERE = Path(__file__).resolve().parent
#: Every operation is rounded for itself; what is rounded once is an explicit fma.
OPTIONS = ['-std=c++20', '-O3', '-ffp-contract=off', '-fno-math-errno', '-fno-trapping-math',
           '-fwrapv', '-fvisibility=hidden', '-fPIC', '-fno-exceptions', '-fno-rtti', '-w',
           '-Werror=return-type', '-Werror=float-conversion']
#: Of the loops, in which the kernels say which doubles share a register. With GCC, lanes fit into
#: the registers only if instructions are scheduled first, which makes other loops slower.
LOOP_OPTIONS, LANES_OPTIONS = ['-fno-tree-slp-vectorize'], ['-fschedule-insns', '-fsched-pressure']
#: The groups that a level with a `rest` has code of its own for: most motions, which have no terms
#: (only they have lanes), and those under torques of the motors.
_LANES, _TANGENTS = 'lanes', 'tangents'
_OWN = (_LANES, _TANGENTS, 'loop', 'loop_terms_motors')
#: The group of all other kernels.
_OTHERS = 'others'
_TERMS = ('', '.motors', '.space', '.fields', '.lags', '.friction')


@dataclass(frozen=True)
class Signature:
    """A kernel that is compiled for some arguments."""

    kernel: Any
    symbol: str
    arguments: tuple[Part, ...]

    @property
    def group(self) -> str:
        """Return the name of the group that is compiled together."""
        kinds = {part.label: part.kind for argument in self.arguments for part in argument.flat}
        if 'rows.terms' not in kinds:
            return _OTHERS
        if self.kernel.__name__ == 'run_tangents':
            return _TANGENTS
        if self.kernel.__name__ == 'run_each' and kinds['rows.terms'] == '-':
            return _LANES
        names = [name.strip('.') or 'terms' for name in _TERMS
                 if kinds.get(f'rows.terms{name}', '-') != '-']
        return '_'.join(['loop', *names])

    def holder(self, level: Level) -> Level:
        """Return the level whose code a level takes."""
        return level if self.group in _OWN or not level.rest else LEVELS[level.rest]

    def wrapper(self) -> str:
        """Return the function that takes the arguments from the slots of boundary.c."""
        slots = iter(range(1000))
        call = (f'{short_name(self.kernel.__module__)}::{self.kernel.__name__}('
                f"{', '.join(_value(part, slots) for part in self.arguments)})")
        if results(self.kernel) != '-':
            call = f'py::store(results, {call})'
        return (f'extern "C" int32_t KERNEL({self.symbol})(int64_t *results, const Slot *slots) '
                f'{{\n  {call};\n  return 0;\n}}\n')


def write(folder: Path, names: list[str]) -> None:
    """Write the sources and the table of some levels."""
    modules, kernels = load()
    (folder / 'kernels.hpp').write_text(translated(modules), encoding='utf-8')
    found = [Signature(kernel, f'kernel_{kernel.__name__}_{place}', arguments)
             for kernel in kernels for place, arguments in enumerate(signatures(kernel))]
    groups: dict[str, list[str]] = {}
    for each in found:
        groups.setdefault(each.group, ['#include "kernels.hpp"\n']).append(each.wrapper())
    for name, texts in groups.items():
        (folder / f'{name}.cpp').write_text('\n'.join(texts), encoding='utf-8')
    (folder / 'table.h').write_text(_table(found, names), encoding='ascii')


def compile_all(folder: Path, names: list[str], compiler: list[str]) -> None:
    """
    Compile the sources in a folder for some levels.

    `compiler` is a command and options, which come last. Raises `subprocess.CalledProcessError`.
    """
    version = subprocess.run([compiler[0], '--version'], capture_output=True, check=True).stdout
    lanes_options = LOOP_OPTIONS + ([] if b'clang' in version else LANES_OPTIONS)
    commands = []
    for source in sorted(folder.glob('*.cpp')):
        more = {_OTHERS: [], _LANES: lanes_options}.get(source.stem, LOOP_OPTIONS)
        for level in map(LEVELS.get, names):
            if source.stem in _OWN or not level.rest:
                commands.append([
                    compiler[0], *OPTIONS, *more, *level.options, f'-DLANES={level.lanes}',
                    f'-DSUFFIX={level.suffix}', f'-I{HERE}', *compiler[1:], '-c', source, '-o',
                    source.with_name(f'{source.stem}{level.suffix}.o')])
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(lambda command: subprocess.run(command, check=True), commands))


def _value(part: Part, slots: Any) -> str:
    # Return an argument in C++.
    if part.kind == '-':
        return 'py::None{}'
    if part.kind == '(':
        return f"{part.cpp_type}{{{', '.join(_value(each, slots) for each in part.parts)}}}"
    slot = f'slots[{next(slots)}]'
    if part.kind == 'F':
        return f'py::number({slot})'
    if part.kind in ('B', 'I'):
        return f"{'bool' if part.kind == 'B' else 'int64_t'}({slot}.shape[0])"
    return f'py::array<{part.cpp_type}, {len(part.dimensions)}>({slot})'


def _row(part: Part) -> str:
    # Return an element of the parts of a signature, in C.
    dimensions = ', '.join(
        f'{{{each.factor}, {VARIABLES.find(each.variable) if each.variable else -1}, '
        f'{each.offset}, {each.other}}}' for each in part.dimensions)
    count = len(part.parts) if part.kind == '(' else len(part.dimensions)
    return (f"{{'{part.kind}', {count}, {int(part.is_written)}, {part.size}, "
            f'{{{dimensions or "{0}"}}}, "{part.label}", "{part.text}"}}')


def _table(found: list[Signature], names: list[str]) -> str:
    lines = []
    for each in found:
        calls = [each.symbol + each.holder(LEVELS[name]).suffix for name in names]
        lines += [f'extern kernel {call};' for call in dict.fromkeys(calls)]
        lines.append(f'static const part {each.symbol}_parts[] = {{')
        lines += [f'  {_row(part)},' for argument in each.arguments for part in argument.flat]
        lines += ['};', f'#define {each.symbol} {{{each.symbol}_parts, {{{", ".join(calls)}}}}}']
    entries = []
    for kernel in dict.fromkeys(each.kernel for each in found):
        own = [each for each in found if each.kernel is kernel]
        name, symbols = kernel.__name__, ', '.join(each.symbol for each in own)
        lines.append(f'static const signature {name}_signatures[] = {{{symbols}}};')
        entries.append(f'  {{"{name}", "{results(kernel)}", {len(own[0].arguments)}, {len(own)}, '
                       f'{name}_signatures}},')
    leaves = max(sum(len(part.flat) for part in each.arguments) for each in found)
    most = max(len(results(each.kernel)) for each in found)
    return '\n'.join([
        *lines, 'static const entry entries[] = {', *entries, '};',
        f'_Static_assert(LEAVES >= {leaves} && LEVELS >= {len(names)} && RESULTS >= {most}, '
        '"too small");', 'static const struct { const char *name; int lanes; } levels[] = {',
        *(f'  {{"{name}", {LEVELS[name].lanes}}},' for name in names), '};', ''])


def main() -> None:
    """Write and compile; exit with a message if that fails."""
    folder, *rest = sys.argv[1:]
    names, command = rest[:rest.index('--')], rest[rest.index('--') + 1:]
    try:
        write(Path(folder), names)
        compile_all(Path(folder), names, command)
    except RejectedError as error:
        sys.exit(str(error))
    except (OSError, subprocess.CalledProcessError):
        sys.exit(f"expected kernels that {' '.join(command)} compiles; the error stands above")


if __name__ == '__main__':
    main()
