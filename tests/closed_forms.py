"""Closed-form results that are shared by several tests."""

import math

from scipy.special import gamma


def greatest_penetration(stiffness, exponent, mass, speed):
    """Penetration of an undamped impact with F = K δⁿ: ½ m v² = K δⁿ⁺¹/(n+1)."""
    n = exponent
    return ((n + 1) * mass * speed**2 / (2 * stiffness)) ** (1 / (n + 1))


def contact_time(stiffness, exponent, mass, speed):
    """Duration of an undamped impact with F = K δⁿ; π √(m/K) for n = 1, 2.9433 δ_max/v for n = 3/2."""
    n = exponent
    factor = 2 * math.sqrt(math.pi) * gamma(1 + 1 / (n + 1)) / gamma(0.5 + 1 / (n + 1))
    return factor * greatest_penetration(stiffness, n, mass, speed) / speed


def sliding_acceleration(slope, mu, g=9.81):
    """Acceleration of a block that slides down a slope [rad] with Coulomb friction."""
    return g * (math.sin(slope) - mu * math.cos(slope))


def creep_speed(slope, mu, velocity_scale):
    """Creep speed of a block with tanh friction on a slope below the friction angle: μ tanh(v/v_s) = tan θ."""
    return velocity_scale * math.atanh(math.tan(slope) / mu)
