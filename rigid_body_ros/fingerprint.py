"""What the last bits of a motion depend on, besides scene and torques."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
import platform

NAME = 'rigid_body_ros'


def fingerprint() -> dict[str, str]:
    """Return versions and processor: where all agree, so do all bits of a motion."""
    found = {package: _version(package) for package in (NAME, 'numpy', 'numba', 'llvmlite')}
    return {**found, 'processor': _processor()}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:  # run from its folder
        return 'none'


def _processor() -> str:
    try:
        from llvmlite import binding
    except ImportError:
        return platform.machine()
    return f'{platform.machine()} {binding.get_host_cpu_name()}'
