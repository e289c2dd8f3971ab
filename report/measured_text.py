"""What `bssrdf measure` found, in words."""

from __future__ import annotations

from bssrdf.measure import MEANING, Measured


def measured_text(measured: Measured) -> str:
    """The images made; with a slice, R and the extent of the curve by channel, and the flags."""
    lines = [f"merged {kind}: {' × '.join(map(str, hdr.radiance.shape))}" for kind, hdr in measured.images.items()]
    if measured.slice is not None:
        for name, channel in measured.slice.channels.items():
            total = "no R, saturated"
            if name in measured.slice.total_r:
                sd = measured.slice.total_r_sd[name]
                total = f"R {measured.slice.total_r[name]:.4f} ± {sd:.4f} as the camera saw it"
            reach = f"{channel.r_mm[0]:.2g}–{channel.r_mm[-1]:.3g} mm"
            lines.append(f"{name}: {total}, {len(channel.r_mm)} radii, {reach}")
        found = measured.provenance.get("found", {})
        for image, seen in measured.slice.provenance.get("isophotes", {}).items():
            angle = f"view angle {seen['view_angle_deg']:.1f}°" if "view_angle_deg" in seen else "no view angle"
            lines.append(
                f"isophotes of the {image}: {seen['aspect']:.3f} to 1 along the view, ± {seen['aspect_rel_sd']:.3f}: "
                f"{angle} would make circles of them"
            )
        lines += [f"{flag}: {MEANING[flag]}{_value(found.get(flag))}" for flag in measured.slice.flags]
    return "\n".join(lines)


def _value(found: str | None) -> str:
    """What was found of a flag, in figures, where it has any."""
    return f" ({found})" if found else ""
