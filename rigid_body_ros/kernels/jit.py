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
Compilation of the numeric kernels with numba, cached on disk.

Without numba the kernels run as plain Python: the same bits, hundreds of times slower.
"""

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
    from numba.extending import intrinsic, overload
except ImportError:
    numba = None

#: Whether kernels are compiled: numba is installed, and NUMBA_DISABLE_JIT is not set.
COMPILES = numba is not None and not numba.config.DISABLE_JIT

#: Options without wrappers for calls from Python and C.
_INTERNAL = {'error_model': 'numpy', 'no_cpython_wrapper': True, 'no_cfunc_wrapper': True}

Kernel = TypeVar('Kernel', bound=Callable[..., Any])


def njit(kernel: Kernel) -> Kernel:
    """
    Compile a kernel that Python calls, on its first call, and cache the result on disk.

    The kernel releases the GIL. Arithmetic follows IEEE 754 (no fast-math), so a kernel returns
    the same bits wherever it is inlined. The cached code is valid as long as the hash of the
    package's sources stays the same. If no cache folder is writable, as in a read-only install
    without a home folder, every process compiles the kernels again and issues one warning.
    Without numba the plain function is returned.
    """
    if not COMPILES:
        return kernel
    options = {'error_model': 'numpy', 'nogil': True}
    try:
        compiled = numba.njit(cache=True, **options)(kernel)
    except RuntimeError:
        _warn_uncached()
        return numba.njit(**options)(kernel)
    # numba compares only time and size of the kernel's own file, not of the files whose functions
    # it inlines. Also, a copied file may have the time of the file that it replaces.
    compiled._cache._cache_file._source_stamp = _sources_hash()
    return compiled


def internal(kernel: Kernel) -> Kernel:
    """Compile a function that kernels call and Python cannot; it is cached with the kernels."""
    return _internal(kernel)


def inlined(kernel: Kernel) -> Kernel:
    """
    Inline a function into each kernel that calls it; Python cannot call it.

    Without inlining, a call passes tuples in memory, which takes as long as the arithmetic of a
    short step.
    """
    return _internal(kernel, forceinline=True)


def optional(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """
    Compile an inlined function for a part that not every scene has.

    If its first argument is None, it returns None. The compiler chooses by type, so it compiles a
    scene without the part without the code for it.
    """
    def choose(first: Any, *rest: Any) -> Any:
        return None if first is None else kernel(first, *rest)

    if not COMPILES:
        return choose
    compiled = inlined(kernel)

    def by_type(first: Any, *rest: Any) -> Any:
        if isinstance(first, numba.types.NoneType):
            return lambda first, *rest: None
        return lambda first, *rest: compiled(first, *rest)

    overload(choose, strict=False, jit_options={**_INTERNAL, 'forceinline': True})(by_type)
    return choose


def _internal(kernel: Kernel, **options: bool) -> Kernel:
    # Without wrappers for calls from Python and C, which take as long to compile as the function.
    if not COMPILES:
        return kernel
    compiled = numba.njit(**_INTERNAL, **options)(kernel)
    compiled.__class__ = _internal_type()
    return compiled


@cache
def _internal_type() -> Any:
    def reject(self: Any, *_: Any) -> None:  # a call without a wrapper crashes the interpreter
        raise TypeError(f'{self.py_func.__name__} is internal to the kernels: '
                        'it cannot be called from Python')
    return type('Internal', (type(numba.njit(reject)),), {'__call__': reject})


def _warn_uncached() -> None:
    # Because text and place are constant, Python's own filter shows the warning once per process.
    warnings.warn(
        'no writable cache folder: every start compiles the kernels again; '
        'set NUMBA_CACHE_DIR to a writable folder',
        RuntimeWarning,
        stacklevel=1,
    )


@cache
def _sources_hash() -> str:
    digest = hashlib.sha256()
    for source in _sources(resources.files(__name__.partition('.')[0])):
        digest.update(source.read_bytes())
    return digest.hexdigest()


def _sources(folder: Any) -> Iterator[Any]:
    """Yield the sources in a folder, which may be in a zip file, and its subfolders, sorted."""
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


#: fma(a, b, c) returns a b + c, rounded once. It takes half the time of a product and a sum, and
#: fma(a, b, -(a * b)) is the rounding error of a product. Kernels call it explicitly, because a
#: compiler may fuse a formula in one place and not in another.
fma: Callable[[float, float, float], float] = \
    intrinsic(_generate_fma) if COMPILES else _exact_fma
