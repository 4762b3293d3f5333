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

"""Check output files before a command does any work, and write them when it is done."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
import json
import os
from pathlib import Path
import shlex
from typing import Any, TYPE_CHECKING

from rigid_body_ros.common.errors import printable
from rigid_body_ros.runtime import files
from rigid_body_ros.runtime.terminal import show

if TYPE_CHECKING:
    from rigid_body_ros.report.report import Report
    from rigid_body_ros.scene import Scene

#: The options that name recordings, the options that name files of any kind, and the suffixes of
#: the command's outputs.
_INPUTS = 'input', 'recording', 'motion', 'reference', 'vary', 'uncertain'
_PATHS = *_INPUTS, 'scene', 'output', 'json', 'plot', 'report'
_SUFFIXES = {'json': '.json', 'plot': '.png', 'report': '.html'}


@contextmanager
def checked(options: argparse.Namespace,
            *outputs: tuple[str | None, str]) -> Iterator[Outputs]:
    """
    Check the outputs of a command, and protect its inputs within the context.

    Parameters
    ----------
    options : Namespace
        The options as returned by `Command.parsed`. The outputs named by --json, --plot and
        --report are checked.
    outputs : tuples of path or None and suffix
        Other outputs to check; see `files.check`.

    Raises
    ------
    InputError
        An output is rejected by `files.check`.

    """
    inputs = *_given(options, *_INPUTS), *_measured_files(options)
    with files.reading(*inputs, scene=options.scene):
        yield Outputs(options, *outputs)


class Outputs:
    """
    The outputs named in the options of a command; see `checked`.

    Attributes
    ----------
    names : list of str
        The paths of the outputs.

    """

    def __init__(self, options: argparse.Namespace, *outputs: tuple[str | None, str]) -> None:
        shared = [(getattr(options, name, None), suffix) for name, suffix in _SUFFIXES.items()]
        named = [(path, suffix) for path, suffix in (*outputs, *shared) if path]
        with files.overwriting(options.overwrite):
            files.check(*named)
        self._options, self._suffixes = options, dict(named)
        self.names = [*self._suffixes]

    @contextmanager
    def writing(self, name: str | None = None) -> Iterator[None]:
        """Within the context, allow `name` to be written, but protect all other outputs."""
        with files.protected('output', *(other for other in self.names if other != name)), \
                files.overwriting(self._options.overwrite):
            yield

    def write(self, name: str, write: Callable[[Path], object]) -> None:
        """Write an output by calling `write` with the path to write to."""
        with self.writing(name), files.atomic_output(name, self._suffixes[name]) as path:
            write(path)

    def write_text(self, name: str, text: str) -> None:
        """Write text to an output."""
        self.write(name, lambda path: path.write_text(text, encoding='utf-8'))

    def write_asked(self, scene: Scene | None, report: Callable[[], Report],
                    data: Callable[[], Mapping[str, Any]] = dict) -> None:
        """
        Write the outputs that the user has requested with --json, --plot or --report.

        Parameters
        ----------
        scene : Scene, optional
            The scene of the motion.
        report : callable
            Returns the report, for a page and a plot.
        data : callable
            Returns the result as JSON data.

        """
        asked = vars(self._options)
        if name := asked.get('json'):
            self.write_text(name, f'{json.dumps(data(), indent=1)}\n')
        if not (asked.get('plot') or asked.get('report')):
            return
        made = replace(report(), warnings=scene.warnings if scene else (), scene=scene,
                       command=_command_line(self._options))
        if name := asked.get('plot'):
            from rigid_body_ros.report.picture import draw  # matplotlib is slow to import
            self.write(name, lambda path: draw(path, made))
        if name := asked.get('report'):
            from rigid_body_ros.report.page import write
            with self.writing(name):
                write(name, made)

    def show(self, summary: str, width: int, names: list[str] | None = None) -> None:
        """Print a summary and the names of the outputs; the row name is padded to `width`."""
        shown = ', '.join(self.names if names is None else names)
        show(summary + (f'\n{"wrote":{width}}{printable(shown)}' if shown else ''))


def _given(options: argparse.Namespace, *names: str) -> list[str]:
    """Return the paths in the named options; an option may contain any number of paths."""
    values = [value for name in names if (value := getattr(options, name, None))]
    return [path for value in values for path in (value if isinstance(value, list) else [value])]


def _measured_files(options: argparse.Namespace) -> list[str]:
    """Return the files that the arguments of --measured name."""
    from rigid_body_ros.recording.measurements import parts_of
    files = (parts_of('', name)[0] for name in _given(options, 'measured'))
    return [os.fspath(file) for file in files if file]


def _command_line(options: argparse.Namespace) -> str:
    """Return the command line with the folders removed from all paths."""
    paths = [*map(os.fspath, _given(options, *_PATHS)), *_measured_files(options)]
    return shlex.join([options.command, *(_without_folder(os.fspath(text), paths)
                                          for text in options.arguments)])


def _without_folder(argument: str, paths: list[str]) -> str:
    for path in paths:
        option = argument.removesuffix(path)
        if option != argument and (not option or option.startswith('-')):
            return option + os.path.basename(os.path.abspath(path))
    return argument
