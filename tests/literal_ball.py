"""A literal photon walk in a ball under a parallel beam as wide as itself: the reference for curved bodies.

Kept apart from the package: its own sphere, NumPy's generator, Henyey and Greenstein's angle, Fresnel's equations and
Snell's law. `python tests/literal_ball.py` writes the curves in fixtures/. Lengths in mm, coefficients in 1/mm;
values are light per area over the beam's irradiance, by the cosine of the angle to the beam, and light per solid angle
over the beam's flux, by the cosine of its direction against the beam's.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FIXTURES = Path(__file__).parent / "fixtures"
BATCHES = 20
RINGS = 20
"""Of equal area, from the shaded pole (cosine −1) to the one in the beam's middle."""
LEAST_WEIGHT, SURVIVAL = 1e-3, 0.1


@dataclass(frozen=True)
class WalkedBall:
    """A ball of one medium, and how many photons tell its light."""

    sigma_a: float
    sigma_sp: float
    eta: float
    g: float
    radius: float
    photons: int


@njit
def reflectance(index: float, cos_i: float) -> float:
    """Fresnel's, for light that meets a medium of that index relative to its own."""
    sin2 = (1.0 - cos_i * cos_i) / (index * index)
    if sin2 >= 1.0:
        return 1.0
    cos_t = np.sqrt(1.0 - sin2)
    r_s = (cos_i - index * cos_t) / (cos_i + index * cos_t)
    r_p = (index * cos_i - cos_t) / (index * cos_i + cos_t)
    return (r_s * r_s + r_p * r_p) / 2.0


@njit
def walk(
    rng: np.random.Generator, photons: int, sigma_a: float, sigma_s: float, g: float, eta: float, radius: float
) -> tuple[Floats, Floats, int]:
    """Weight that left through each ring and in each range of directions, per photon, and the steps taken."""
    out, ways = np.zeros(RINGS), np.zeros(RINGS)
    sigma_t = sigma_a + sigma_s
    steps = 0
    p, d, n = np.zeros(3), np.zeros(3), np.zeros(3)
    for _ in range(photons):
        rho, phi = np.sqrt(rng.random()), 2.0 * np.pi * rng.random()
        cos_i = np.sqrt(1.0 - rho * rho)
        p[0], p[1], p[2] = radius * rho * np.cos(phi), radius * rho * np.sin(phi), radius * cos_i
        weight = 1.0 - reflectance(eta, cos_i)
        cos_in = np.sqrt(1.0 - rho * rho / (eta * eta))
        for i in range(3):  # the beam runs along −z
            d[i] = -(cos_in - cos_i / eta) * p[i] / radius
        d[2] -= 1.0 / eta
        while weight > 0.0:
            step = -np.log(1.0 - rng.random()) / sigma_t
            steps += 1
            along = p[0] * d[0] + p[1] * d[1] + p[2] * d[2]
            off = radius * radius - (p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
            ahead = -along + np.sqrt(max(along * along + off, 0.0))  # to the surface
            if step < ahead:
                for i in range(3):
                    p[i] += step * d[i]
                weight *= sigma_s / sigma_t
                if weight < LEAST_WEIGHT:
                    weight = weight / SURVIVAL if rng.random() < SURVIVAL else 0.0
                turn(rng, d, g)
                continue
            for i in range(3):
                p[i] += ahead * d[i]
            scale = radius / np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
            for i in range(3):
                p[i] *= scale
                n[i] = p[i] / radius
            cos_in = d[0] * n[0] + d[1] * n[1] + d[2] * n[2]
            if rng.random() >= reflectance(1.0 / eta, cos_in):
                out[min(int((n[2] + 1.0) / 2.0 * RINGS), RINGS - 1)] += weight
                cos_out = np.sqrt(max(1.0 - eta * eta * (1.0 - cos_in * cos_in), 0.0))
                up = eta * (d[2] - cos_in * n[2]) + cos_out * n[2]
                ways[min(int((up + 1.0) / 2.0 * RINGS), RINGS - 1)] += weight
                break
            for i in range(3):
                d[i] -= 2.0 * cos_in * n[i]
    return out / photons, ways / photons, steps


@njit
def turn(rng: np.random.Generator, d: Floats, g: float) -> None:
    """Scatter a unit vector."""
    if g == 0.0:
        cos_turn = 2.0 * rng.random() - 1.0
    else:
        ratio = (1.0 - g * g) / (1.0 - g + 2.0 * g * rng.random())
        cos_turn = (1.0 + g * g - ratio * ratio) / (2.0 * g)
    sin_turn = np.sqrt(max(0.0, 1.0 - cos_turn * cos_turn))
    about = 2.0 * np.pi * rng.random()
    x, y, z = d[0], d[1], d[2]
    if abs(z) > 0.99999:
        d[0], d[1], d[2] = sin_turn * np.cos(about), sin_turn * np.sin(about), np.copysign(cos_turn, z * cos_turn)
    else:
        across = np.sqrt(1.0 - z * z)
        d[0] = sin_turn * (x * z * np.cos(about) - y * np.sin(about)) / across + x * cos_turn
        d[1] = sin_turn * (y * z * np.cos(about) + x * np.sin(about)) / across + y * cos_turn
        d[2] = -sin_turn * np.cos(about) * across + z * cos_turn
    norm = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    for i in range(3):
        d[i] /= norm


def light(ball: WalkedBall, photons: int, seed: int) -> tuple[Floats, int]:
    """Exitance of rings over the beam's irradiance, its standard error, intensity over the beam's flux and its, (4, n).

    And the steps taken.
    """
    sigma_s = ball.sigma_sp / (1 - ball.g)
    streams = np.random.default_rng(seed).spawn(BATCHES)
    each = -(-photons // BATCHES)
    runs = [walk(rng, each, ball.sigma_a, sigma_s, ball.g, ball.eta, ball.radius) for rng in streams]
    found = []
    for batches in (
        np.array([run[0] for run in runs]) * RINGS / 4,
        np.array([run[1] for run in runs]) * RINGS / 4 / np.pi,
    ):
        found += [batches.mean(axis=0), batches.std(axis=0, ddof=1) / np.sqrt(BATCHES)]
    return np.array(found), sum(run[2] for run in runs)


BALLS = {
    "skin1R_ball3": WalkedBall(0.032, 0.74, 1.3, 0.0, 4.1, 4_000_000),
    "skin1B_ball3": WalkedBall(0.48, 1.01, 1.3, 0.0, 4.1, 4_000_000),
    "skin1R_g0.85_ball3": WalkedBall(0.032, 0.74, 1.3, 0.85, 4.1, 2_000_000),
    "marbleG_ball1": WalkedBall(0.0041, 2.62, 1.5, 0.0, 5.56, 2_000_000),
    "matched_ball3": WalkedBall(0.17, 0.88, 1.0, 0.0, 4.1, 4_000_000),
}


def read(name: str) -> Floats:
    """What `light` found."""
    return np.loadtxt(FIXTURES / f"{name}.csv", delimiter=",", skiprows=3)[:, 2:].T


def write(name: str, ball: WalkedBall) -> None:
    found, steps = light(ball, ball.photons, seed=1)
    edges = np.linspace(-1, 1, RINGS + 1)
    rows = zip(edges[:-1], edges[1:], *found, strict=True)
    head = (
        f"# tests/literal_ball.py, {ball.photons} photons, {steps:.2g} steps: {ball.radius} mm ball, parallel beam\n"
        f"# sigma_s_prime={ball.sigma_sp}/mm sigma_a={ball.sigma_a}/mm eta={ball.eta} g={ball.g}\n"
        "cos_lo,cos_hi,exitance_over_irradiance,se,intensity_over_flux_per_sr,se\n"
    )
    body = "".join(",".join(f"{each:.6g}" for each in row) + "\n" for row in rows)
    (FIXTURES / f"{name}.csv").write_text(head + body, encoding="utf-8")


if __name__ == "__main__":
    for name, ball in BALLS.items():
        write(name, ball)
        print(name)
