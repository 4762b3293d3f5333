"""Compile the numeric kernels with numba where it is installed, and keep what was compiled."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar
import warnings

try:
    import numba
except ImportError:
    numba = None

Kernel = TypeVar('Kernel', bound=Callable[..., Any])


def njit(kernel: Kernel) -> Kernel:
    """
    Compile a kernel on its first call, and cache the result on disk.

    IEEE arithmetic is kept (no fast-math), so a kernel gives the same bits wherever it is
    inlined. Without numba the plain function is returned: the same results within rounding,
    hundreds of times slower. Where no cache folder can be written, as in a read-only install
    without a home, kernels are compiled anew by every process, and one warning says so.
    """
    if numba is None:
        return kernel
    try:
        compiled = numba.njit(cache=True, error_model='numpy')(kernel)
    except RuntimeError:
        _warn_uncached()
        return numba.njit(error_model='numpy')(kernel)
    _drop_stale(Path(compiled.stats.cache_path), kernel, _newest_source())
    return compiled


def _warn_uncached() -> None:
    # A constant text at a constant place: Python's own filter shows it once a process.
    warnings.warn(
        'no folder for compiled kernels can be written: every start compiles them again; '
        'set NUMBA_CACHE_DIR to a writable folder',
        RuntimeWarning,
        stacklevel=1,
    )


@cache
def _newest_source() -> float:
    sources = Path(__file__).parent.rglob('*.py')
    return max((source.stat().st_mtime for source in sources), default=0.0)


def _drop_stale(folder: Path, kernel: Callable[..., Any], newest: float) -> None:
    # numba compares a cached kernel with its own file only, not with the files of the kernels
    # inlined into it: after a change in one module the others would go on running the old code.
    name = f'{Path(kernel.__code__.co_filename).stem}.{kernel.__qualname__}'
    for index in folder.glob(f'{name}-*.nbi'):
        try:
            if index.stat().st_mtime < newest:
                index.unlink()
        except OSError:
            pass  # another process was faster
