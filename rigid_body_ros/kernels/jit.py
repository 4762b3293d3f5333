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
from contextlib import contextmanager, ExitStack, suppress
import fcntl
from functools import cache, cached_property
import hashlib
from importlib import resources
import os
from pathlib import Path
from typing import Any, TypeVar
import warnings

import numpy as np

try:
    import numba
    from numba.core.runtime import rtsys
    from numba.extending import overload
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
    package's sources stays the same. Of several processes that need a kernel, one compiles it and
    the others wait for its code. If no cache folder is writable, as in a read-only install
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
        compiled = numba.njit(**options)(kernel)
        compiled._cache = _AnnouncedCache(compiled._cache)
        return compiled
    # numba compares only time and size of the kernel's own file, not of the files whose functions
    # it inlines. Also, a copied file may have the time of the file that it replaces.
    compiled._cache._cache_file._source_stamp = sources_hash()
    compiled._cache = _SharedCache(compiled._cache)
    return compiled


@contextmanager
def announced(announce: Callable[[], None]) -> Iterator[None]:
    """Call a function once before this context waits for a kernel to be compiled."""
    _announcements.append(announce)
    try:
        yield
    finally:
        if announce in _announcements:
            _announcements.remove(announce)


_announcements: list[Callable[[], None]] = []


def _announce() -> None:
    while _announcements:
        _announcements.pop()()


class _AnnouncedCache:
    """The cache of a kernel, which announces the compilation."""

    def __init__(self, cache: Any) -> None:
        self._cache = cache

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cache, name)

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return the cached code; None if there is none, and then this process compiles it."""
        _announce()
        return self._cache.load_overload(signature, context)


class _SharedCache(_AnnouncedCache):
    """The cache of a kernel, shared by processes: one compiles while the others wait."""

    def __init__(self, cache: Any) -> None:
        super().__init__(cache)
        #: Held while this process compiles.
        self._lock = ExitStack()

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return the cached code; None if there is none, and then this process compiles it."""
        self._lock.close()  # of a compilation that failed
        found = self._load(signature, context)
        if found is None:
            _announce()
            self._lock.enter_context(
                _locked(Path(self.cache_path), self._impl.filename_base + '.lock'))
            found = self._load(signature, context)
            if found is not None:
                self._lock.close()
        return found

    def save_overload(self, signature: Any, code: Any) -> None:
        """Save compiled code."""
        with self._lock:
            self._cache.save_overload(signature, code)

    def _load(self, signature: Any, context: Any) -> Any:
        # As numba does, but without what only the compiler needs: all functions of numpy that
        # numba can compile, which takes half a second and imports scipy.linalg.
        rtsys.initialize(context)
        return self._cache._load_overload(signature, context)


@contextmanager
def _locked(folder: Path, name: str) -> Iterator[None]:
    """Hold a lock, which ends with its process; where the folder has no locks, hold none."""
    with ExitStack() as stack:
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            lock = os.open(folder / name, os.O_CREAT, 0o666)
            stack.callback(os.close, lock)
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


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


def record(fields: list[tuple[Any, ...]]) -> Any:
    """Return a structured type whose fields a kernel reads as attributes, compiled or not."""
    found = np.dtype(fields, align=True)
    return found if COMPILES else np.dtype((np.record, found))


def _internal(kernel: Kernel, **options: bool) -> Kernel:
    # Without wrappers for calls from Python and C, which take as long to compile as the function.
    if not COMPILES:
        return kernel
    found: Any = _Internal(kernel, **options)
    return found


class _Internal:
    """A function without wrappers: to numba a compiled function, but Python cannot call it."""

    def __init__(self, kernel: Callable[..., Any], **options: bool) -> None:
        self.py_func, self._options = kernel, options

    @property
    def _numba_type_(self) -> Any:
        return self._compiled._numba_type_

    @cached_property
    def _compiled(self) -> Any:
        # Two hundred of these take a tenth of a second, and only the compiler needs them.
        return numba.njit(**_INTERNAL, **self._options)(self.py_func)

    def __call__(self, *_: Any) -> None:
        raise TypeError(f'{self.py_func.__name__} is internal to the kernels: '
                        'it cannot be called from Python')


def _warn_uncached() -> None:
    # Because text and place are constant, Python's own filter shows the warning once per process.
    warnings.warn(
        'no writable cache folder: every start compiles the kernels again; '
        'set NUMBA_CACHE_DIR to a writable folder',
        RuntimeWarning,
        stacklevel=1,
    )


@cache
def sources_hash() -> str:
    """Return a hash of the sources of the package."""
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
