"""What is installed and usable on this computer: `bssrdf doctor`."""

from __future__ import annotations

import importlib.metadata
import platform
import re
import subprocess
from typing import NamedTuple

from bssrdf.render import ADVICE, MISSING, find_backend
from bssrdf.rig import rig_list

_GPU_TIMEOUT_S = 20


class Finding(NamedTuple):
    """One line; `remedy` is empty where nothing is wanting."""

    what: str
    state: str
    remedy: str = ""


def examine() -> list[Finding]:
    """Python and the libraries, what compiles Mitsuba's kernels, GPU, serial ports and cameras."""
    return [Finding("Python", platform.python_version()), *_libraries(), *_renderer(), *_gpus(), *_devices()]


def doctor_text(findings: list[Finding]) -> str:
    """One line a finding, what to do under it."""
    width = max(len(finding.what) for finding in findings)
    lines = []
    for what, state, remedy in findings:
        lines.append(f"{what:<{width}}  {state}")
        if remedy:
            lines.append(f"{'':<{width}}  → {remedy}")
    return "\n".join(lines)


def _libraries() -> list[Finding]:
    """Every library the package asks for, those of extras included."""
    findings = []
    for requirement in importlib.metadata.requires("bssrdf") or []:
        name = re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
        extra = re.search(r"extra == ['\"](\w+)['\"]", requirement)
        if extra and extra[1] in ("all", "dev", "docs"):
            continue
        try:
            findings.append(Finding(name, importlib.metadata.version(name)))
        except importlib.metadata.PackageNotFoundError:
            package = f"bssrdf[{extra[1]}]" if extra else "bssrdf"
            findings.append(Finding(name, "not installed", f'pip install "{package}"'))
    return findings


def _renderer() -> list[Finding]:
    try:
        importlib.metadata.version("mitsuba")
    except importlib.metadata.PackageNotFoundError:
        return [Finding("rendering", "not possible", MISSING)]
    backend = find_backend()
    if backend is None:
        return [Finding("rendering", "not possible", ADVICE)]
    return [Finding("rendering", f"{backend.name}_ad_rgb" + (f" with {backend.library}" if backend.library else ""))]


def _gpus() -> list[Finding]:
    try:
        done = subprocess.run(["nvidia-smi", "-L"], capture_output=True, text=True, timeout=_GPU_TIMEOUT_S)
    except (OSError, subprocess.TimeoutExpired):
        return [Finding("GPU", "none of NVIDIA's; all runs on the processor")]
    lines = done.stdout.splitlines() if done.returncode == 0 else []
    return [Finding("GPU", line) for line in lines] or [Finding("GPU", f"nvidia-smi: {done.stderr.strip()}")]


def _devices() -> list[Finding]:
    connected = rig_list()
    return [Finding("devices", line) for line in connected] or [Finding("devices", "no serial port and no camera")]
