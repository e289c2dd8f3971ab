"""Does an ICC colour profile say that the numbers are linear in light?"""

from __future__ import annotations

import struct
from typing import Any

_HEADER = 128
_CURVES = (b"rTRC", b"kTRC")
_LINEAR_WITHIN = 0.01
"""Of an exponent, and of a table's middle: 8-bit fixed point rounds to 0.004."""


def is_linear_profile(profile: Any) -> bool:
    """Whether its tone curves are straight; no profile, and one without such a curve, say nothing against it."""
    if not isinstance(profile, bytes):
        return True
    try:
        (count,) = struct.unpack_from(">I", profile, _HEADER)
        for i in range(min(count, 100)):
            name, offset, _ = struct.unpack_from(">4sII", profile, _HEADER + 4 + 12 * i)
            if name in _CURVES:
                return _is_straight(profile, offset)
    except struct.error:
        return True
    return True


def _is_straight(profile: bytes, offset: int) -> bool:
    kind = profile[offset : offset + 4]
    if kind == b"para":
        (exponent,) = struct.unpack_from(">i", profile, offset + 12)
        return bool(abs(exponent / 65536 - 1) < _LINEAR_WITHIN)
    (count,) = struct.unpack_from(">I", profile, offset + 8)
    if count == 0:
        return True
    if count == 1:
        return bool(abs(struct.unpack_from(">H", profile, offset + 12)[0] / 256 - 1) < _LINEAR_WITHIN)
    (middle,) = struct.unpack_from(">H", profile, offset + 12 + 2 * (count // 2))
    return bool(abs(middle / 65535 - (count // 2) / (count - 1)) < _LINEAR_WITHIN)
