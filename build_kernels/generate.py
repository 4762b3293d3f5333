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
the boundary.
"""

from __future__ import annotations

import gc
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

#: For numba: no code for this machine's processor and its libraries, and the same names each time.
ENVIRONMENT = {'NUMBA_CPU_NAME': 'generic', 'NUMBA_CPU_FEATURES': '',
               'NUMBA_DISABLE_INTEL_SVML': '1', 'PYTHONHASHSEED': '0'}


def main(folder: Path, levels: list[str]) -> None:
    """Generate the code in one process, and compile it for each level in one of its own."""
    environment = {**os.environ, **ENVIRONMENT}
    subprocess.run([sys.executable, __file__, '--code', str(folder), *levels], check=True,
                   env=environment)
    workers = [subprocess.Popen([sys.executable, __file__, '--level', str(folder), level],
                                env=environment) for level in levels]
    statuses = [worker.wait() for worker in workers]
    if any(statuses):
        sys.exit('expected machine code of the kernels; the error stands above')
    (folder / 'kernels.bc').unlink()


def write_code(folder: Path, levels: list[str]) -> None:
    """Write the code of all kernels, kernels.bc, and their table."""
    from machine_code import keep_raw, Module
    from modules import exported
    gc.disable()  # it would take a tenth of the time
    keep_raw()
    module, kernels = Module(), exported()
    rows = []
    for place, kernel in enumerate(kernels):
        print(f'kernel {place + 1} of {len(kernels)}: {kernel.__name__}', flush=True)
        rows.append(_add(module, kernel))
    (folder / 'kernels.bc').write_bytes(module.linked())
    (folder / 'table.h').write_text(_table(rows, levels), encoding='ascii')


def write_object(folder: Path, level: str) -> None:
    """Write the object file of a level."""
    from machine_code import compiled, LEVELS
    print(f'machine code for {level}', flush=True)
    code = compiled((folder / 'kernels.bc').read_bytes(), LEVELS[level])
    (folder / f'{level}.o').write_bytes(code)


def _add(module: Any, kernel: Any) -> dict[str, Any]:
    from signatures import signatures
    name, found = kernel.__name__, signatures(kernel.py_func)
    symbols = [f'kernel_{name}_{place}' for place in range(len(found))]
    results = [module.add(symbol, kernel, arguments)
               for symbol, arguments in zip(symbols, found)]
    return {'name': name, 'results': results[0], 'arguments': len(found[0]), 'signatures': {
        symbol: [_row(part) for argument in arguments for part in argument.flat]
        for symbol, arguments in zip(symbols, found)}}


def _row(part: Any) -> str:
    # Return an element of the parts of a signature, in C.
    dimensions = ', '.join(
        f'{{{each.factor}, {ord(each.variable) - ord("a") if each.variable else -1}, '
        f'{each.offset}, {each.other}}}' for each in part.dimensions)
    count = len(part.parts) if part.kind == '(' else len(part.dimensions)
    return (f"{{'{part.kind}', {count}, {int(part.is_written)}, {part.size}, "
            f'{{{dimensions or "{0}"}}}, "{part.label}", "{part.text}"}}')


def _table(rows: list[dict[str, Any]], levels: list[str]) -> str:
    from machine_code import LEVELS
    suffixes = [LEVELS[level].suffix for level in levels]
    lines = []
    for row in rows:
        for symbol, parts in row['signatures'].items():
            lines += [f'extern kernel {symbol}{suffix};' for suffix in suffixes]
            lines.append(f'static const part {symbol}_parts[] = {{')
            lines += [f'  {part},' for part in parts] + ['};']
        lines.append(f'static const signature {row["name"]}_signatures[] = {{')
        for symbol in row['signatures']:
            calls = ', '.join(f'{symbol}{suffix}' for suffix in suffixes)
            lines.append(f'  {{{symbol}_parts, {{{calls}}}}},')
        lines.append('};')
    lines.append('static const entry entries[] = {')
    lines += [f'  {{"{row["name"]}", "{row["results"]}", {row["arguments"]}, '
              f'{len(row["signatures"])}, {row["name"]}_signatures}},' for row in rows]
    names = ', '.join(f'"{level}"' for level in levels)
    parts = [parts for row in rows for parts in row['signatures'].values()]
    lines += ['};', f'_Static_assert(LEAVES >= {max(map(len, parts))} && '
              f'RESULTS >= {max(len(row["results"]) for row in rows)}, "too small");',
              f'enum {{ LEVEL_COUNT = {len(levels)} }};',
              f'static const char *const levels[] = {{{names}}};']
    return '\n'.join(lines) + '\n'


if __name__ == '__main__':
    if sys.argv[1] == '--code':
        write_code(Path(sys.argv[2]), sys.argv[3:])
    elif sys.argv[1] == '--level':
        write_object(Path(sys.argv[2]), sys.argv[3])
    else:
        main(Path(sys.argv[1]), sys.argv[2:])
