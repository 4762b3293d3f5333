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

"""Compile the numeric kernels with numba where it is installed, and keep what was compiled."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import cache
import hashlib
from importlib import resources
import math
from typing import Any, TypeVar
import warnings

try:
    import numba
    from numba.extending import intrinsic
except ImportError:
    numba = None

#: Whether kernels are compiled; NUMBA_DISABLE_JIT keeps numba from it.
COMPILES = numba is not None and not numba.config.DISABLE_JIT

Kernel = TypeVar('Kernel', bound=Callable[..., Any])


def njit(kernel: Kernel) -> Kernel:
    """
    Compile a kernel that Python calls on its first call, and cache the result on disk.

    While it runs, other threads of Python do. IEEE arithmetic is kept (no fast-math), so a
    kernel gives the same bits wherever it is inlined. What is cached is used as long as the
    sources of the package have the same hash. Without numba the plain function is returned: the
    same bits, hundreds of times slower. If no cache folder can be written, as
    in a read-only install without a home, every process compiles the kernels again and logs one
    warning.
    """
    if not COMPILES:
        return kernel
    options = {'error_model': 'numpy', 'nogil': True}
    try:
        compiled = numba.njit(cache=True, **options)(kernel)
    except RuntimeError:
        _warn_uncached()
        return numba.njit(**options)(kernel)
    # numba compares time and size of the kernel's own file, not of those that it inlines from, and
    # a copy may keep the time of what it replaces.
    compiled._cache._cache_file._source_stamp = _sources_hash()
    return compiled


def part(kernel: Kernel) -> Kernel:
    """Compile a part of kernels, which Python cannot call; it is cached with what calls it."""
    return _part(kernel)


def inlined(kernel: Kernel) -> Kernel:
    """
    Compile a part of kernels into each that calls it.

    A call hands tuples over in memory, which costs a short step as much as its arithmetic.
    """
    return _part(kernel, forceinline=True)


def _part(kernel: Kernel, **options: bool) -> Kernel:
    # The wrappers for calls from elsewhere take as long to compile as the parts themselves.
    if not COMPILES:
        return kernel
    compiled = numba.njit(error_model='numpy', no_cpython_wrapper=True, no_cfunc_wrapper=True,
                          **options)(kernel)
    compiled.__class__ = _part_type()
    return compiled


@cache
def _part_type() -> Any:
    def refuse(self: Any, *_: Any) -> None:  # a call without a wrapper ends the interpreter
        raise TypeError(f'{self.py_func.__name__} is a part of kernels: Python cannot call it')
    return type('Part', (type(numba.njit(refuse)),), {'__call__': refuse})


def _warn_uncached() -> None:
    # A constant text at a constant place: Python's own filter shows it once a process.
    warnings.warn(
        'no folder for compiled kernels can be written: every start compiles them again; '
        'set NUMBA_CACHE_DIR to a writable folder',
        RuntimeWarning,
        stacklevel=1,
    )


@cache
def _sources_hash() -> str:
    digest = hashlib.sha256()
    for source in _sources(resources.files('rigid_body_ros')):
        digest.update(source.read_bytes())
    return digest.hexdigest()


def _sources(folder: Any) -> Iterator[Any]:
    """Yield the sources in a folder, which may lie in a zip file, and below it, in order."""
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.name.endswith('.py'):
            yield entry
        elif '.' not in entry.name and entry.name != '__pycache__' and entry.is_dir():
            yield from _sources(entry)


def _exact_fma(a: float, b: float, c: float) -> float:
    if not (math.isfinite(a) and math.isfinite(b) and math.isfinite(c)):
        return a * b + c
    return float(Fraction(a) * Fraction(b) + Fraction(c))


def _generate_fma(_context: Any, a: Any, b: Any, c: Any) -> Any:
    def generate(_: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.fma(*values)
    return numba.float64(numba.float64, numba.float64, numba.float64), generate


#: fma(a, b, c) is a b + c, rounded once: half the work of a product and a sum, and what makes
#: the rounding error of a product available, fma(a, b, -(a * b)). It is asked for by name, and
#: not left to the compiler, which may fuse the same formula here and not there.
fma: Callable[[float, float, float], float] = \
    intrinsic(_generate_fma) if COMPILES else _exact_fma
