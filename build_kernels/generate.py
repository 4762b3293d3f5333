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
Generate the machine code of the kernels: `generate.py FOLDER LEVEL...`.

FOLDER gets an object file for each processor level, and table.h, which describes the kernels to
the boundary. A level with a `rest` has only few signatures of its own, see `_holder`.
"""

from __future__ import annotations

import gc
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

from levels import Level, LEVELS

#: For numba: no code for this machine's processor and its libraries, and the same names each time.
ENVIRONMENT = {'NUMBA_CPU_NAME': 'generic', 'NUMBA_CPU_FEATURES': '',
               'NUMBA_DISABLE_INTEL_SVML': '1', 'PYTHONHASHSEED': '0'}


def main(folder: Path, names: list[str]) -> None:
    """Generate the code for each number of lanes, then compile it for each level."""
    lanes = sorted({LEVELS[name].lanes for name in names})
    _run([({'LANES': str(count)}, ['--code', str(folder), *names]) for count in lanes])
    _run([({}, ['--level', str(folder), name]) for name in names])
    for count in lanes:
        _code(folder, count).unlink()


def write_code(folder: Path, names: list[str]) -> None:
    """Write the code for the levels with the lanes of this process; if it is all, the table."""
    from lanes import LANES
    from machine_code import keep_raw, Module
    from modules import exported
    gc.disable()  # it would take a tenth of the time
    keep_raw()
    levels = [LEVELS[name] for name in names]
    here = [level for level in levels if level.lanes == LANES]
    module = Module()
    rows = [_add(module, kernel, here) for kernel in exported()]
    _code(folder, LANES).write_bytes(module.linked())
    if any(not level.rest for level in here):
        (folder / 'table.h').write_text(_table(rows, names), encoding='ascii')


def write_object(folder: Path, name: str) -> None:
    """Write the object file of a level."""
    from machine_code import compiled
    print(f'machine code for {name}', flush=True)
    level = LEVELS[name]
    (folder / f'{name}.o').write_bytes(compiled(_code(folder, level.lanes).read_bytes(), level))


def _run(processes: list[tuple[dict[str, str], list[str]]]) -> None:
    # Run this file several times at once, each with more variables and arguments.
    found = [subprocess.Popen([sys.executable, __file__, *arguments],
                              env={**os.environ, **ENVIRONMENT, **variables})
             for variables, arguments in processes]
    statuses = [process.wait() for process in found]
    if any(statuses):
        sys.exit('expected machine code of the kernels; the error stands above')


def _code(folder: Path, lanes: int) -> Path:
    return folder / f'kernels_{lanes}.bc'


def _holder(level: Level, kernel: str, arguments: tuple[Any, ...]) -> Level:
    # Return the level whose code another takes for a signature. The time to generate code again is
    # spent on the loops without terms, for most motions (only they have lanes), and on that of a
    # motion under torques of the motors.
    kinds = {part.label: part.kind for argument in arguments for part in argument.flat}
    motors, space = kinds.get('rows.terms.motors', '-'), kinds.get('rows.terms.space', '-')
    own = kinds.get('rows.terms') == '-' or (kernel == 'run' and motors != '-' and space == '-')
    return level if own or not level.rest else LEVELS[level.rest]


def _add(module: Any, kernel: Any, levels: list[Level]) -> dict[str, Any]:
    # Compile what levels have of their own of a kernel, and return what the table says of it.
    from signatures import signatures
    name, results = kernel.__name__, ''
    found = {f'kernel_{name}_{place}': arguments
             for place, arguments in enumerate(signatures(kernel.py_func))}
    for symbol, arguments in found.items():
        if any(_holder(level, name, arguments) == level for level in levels):
            print(f'{symbol}, {levels[0].lanes} lanes', flush=True)
            results = module.add(symbol, kernel, arguments)
    return {'name': name, 'results': results, 'signatures': found}


def _row(part: Any) -> str:
    # Return an element of the parts of a signature, in C.
    from signatures import VARIABLES
    dimensions = ', '.join(
        f'{{{each.factor}, {VARIABLES.find(each.variable) if each.variable else -1}, '
        f'{each.offset}, {each.other}}}' for each in part.dimensions)
    count = len(part.parts) if part.kind == '(' else len(part.dimensions)
    return (f"{{'{part.kind}', {count}, {int(part.is_written)}, {part.size}, "
            f'{{{dimensions or "{0}"}}}, "{part.label}", "{part.text}"}}')


def _table(rows: list[dict[str, Any]], names: list[str]) -> str:
    lines = []
    for row in rows:
        calls = {symbol: [symbol + _holder(LEVELS[name], row['name'], arguments).suffix
                          for name in names] for symbol, arguments in row['signatures'].items()}
        for symbol, arguments in row['signatures'].items():
            lines += [f'extern kernel {call};' for call in dict.fromkeys(calls[symbol])]
            lines.append(f'static const part {symbol}_parts[] = {{')
            lines += [f'  {_row(part)},' for each in arguments for part in each.flat] + ['};']
        lines.append(f'static const signature {row["name"]}_signatures[] = {{')
        lines += [f'  {{{symbol}_parts, {{{", ".join(each)}}}}},'
                  for symbol, each in calls.items()] + ['};']
    lines.append('static const entry entries[] = {')
    for row in rows:
        first, *_ = row['signatures'].values()
        lines.append(f'  {{"{row["name"]}", "{row["results"]}", {len(first)}, '
                     f'{len(row["signatures"])}, {row["name"]}_signatures}},')
    leaves = max(sum(len(argument.flat) for argument in arguments)
                 for row in rows for arguments in row['signatures'].values())
    return '\n'.join([
        *lines, '};', f'_Static_assert(LEAVES >= {leaves} && LEVELS >= {len(names)} && '
        f'RESULTS >= {max(len(row["results"]) for row in rows)}, "too small");',
        'static const struct { const char *name; int lanes; } levels[] = {',
        *(f'  {{"{name}", {LEVELS[name].lanes}}},' for name in names), '};', ''])


if __name__ == '__main__':
    if sys.argv[1] == '--code':
        write_code(Path(sys.argv[2]), sys.argv[3:])
    elif sys.argv[1] == '--level':
        write_object(Path(sys.argv[2]), sys.argv[3])
    else:
        main(Path(sys.argv[1]), sys.argv[2:])
