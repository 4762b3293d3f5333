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
Write the outputs in `test/vectors.txt` again, as this engine computes them.

    python benchmarks/make_vectors.py

`docs/vectors.md` describes the file. Write it again only if a change of the results is intended,
and check what changes. The inputs stay as they are. To add a motion, write its inputs into the
file, and the keys and times of its outputs without numbers.
"""

import re

from vectors import alone, Motion, Output, read, VECTORS


def line(output: Output) -> str:
    """Return the line of an output, with hexadecimal numbers without trailing zeros."""
    key = f'state {output.time_ns}' if output.key == 'state' else output.key
    return ' '.join([key, *(re.sub(r'\.?0+p', 'p', number.hex()) for number in output.numbers)])


def rewritten(block: str, motion: Motion) -> str:
    """Return the lines of a motion with its present outputs."""
    inputs = block.partition('\nstate ')[0]
    return '\n'.join([inputs, *map(line, alone(motion))])


def main() -> None:
    """Write the file."""
    header, *blocks = VECTORS.read_text(encoding='ascii').strip().split('\n\n')
    blocks = map(rewritten, blocks, read())
    VECTORS.write_text('\n\n'.join([header, *blocks]) + '\n', encoding='ascii')


if __name__ == '__main__':
    main()
