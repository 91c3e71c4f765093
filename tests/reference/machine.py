"""A synchronous machine in rotor coordinates with its sampled current control."""

from __future__ import annotations

import math
from typing import Any

from scipy.optimize import brentq


class Machine:
    """Constants of one machine, and its control, which acts at given instants."""

    def __init__(self, p: Any, temperature: float) -> None:
        self.p, self.m = p, p.machine
        m = self.m
        rise = m.copper_coefficient * (temperature - m.copper_reference)
        self.r = m.resistance * (1.0 + rise)
        self.integral = [0.0, 0.0]
        self.voltage = (0.0, 0.0)
        self.setpoint = 0.0

    def _sign(self, speed: float) -> float:
        return min(max(speed / 2.0, -1.0), 1.0)

    def air_gap(self, i_d: float, i_q: float) -> float:
        """Return the field's torque on the rotor, N m."""
        m = self.m
        return float(1.5 * m.pole_pairs * (m.flux + (m.inductance_d - m.inductance_q) * i_d) * i_q)

    def braking(self, i_d: float, i_q: float, speed: float) -> float:
        """Return the torque that iron, bearings and air take, N m."""
        m = self.m
        square = (m.flux + m.inductance_d * i_d) ** 2 + (m.inductance_q * i_q) ** 2
        iron = m.hysteresis * self._sign(speed) + m.eddy * m.pole_pairs * speed
        drag = m.drag * self._sign(speed) + m.windage * speed * abs(speed)
        return float(m.pole_pairs * iron * square + drag)

    def rates(self, i_d: float, i_q: float, speed: float) -> tuple[float, float]:
        """Return di_d/dt and di_q/dt under the voltage that the control last set."""
        m = self.m
        w = m.pole_pairs * speed
        v_d, v_q = self.voltage
        return (
            (v_d - self.r * i_d + w * m.inductance_q * i_q) / m.inductance_d,
            (v_q - self.r * i_q - w * (m.inductance_d * i_d + m.flux)) / m.inductance_q,
        )

    def _references(self, torque: float) -> tuple[float, float]:
        """Return the currents of least size that give this air-gap torque."""
        m = self.m
        salience = m.inductance_q - m.inductance_d

        def along(current: float) -> tuple[float, float]:
            i_d = -2.0 * salience * current**2
            i_d /= m.flux + math.sqrt(m.flux**2 + 8.0 * (salience * current) ** 2)
            return i_d, math.sqrt(current**2 - i_d**2)

        def short_of(current: float) -> float:
            return self.air_gap(*along(current)) - abs(torque)

        if torque == 0.0:
            return 0.0, 0.0
        most = 2.0 * self.p.limits.current_rms
        i_d, i_q = along(brentq(short_of, 0.0, most, xtol=1e-12))
        return i_d, math.copysign(i_q, torque)

    def control(self, request: float, i_d: float, i_q: float, speed: float) -> None:
        """Act once: slew the request, find currents, set the voltage (which must not reach its limit)."""
        m, c = self.m, self.p.control
        most = self.p.slew_rate * c.period
        self.setpoint = min(max(request, self.setpoint - most), self.setpoint + most)
        compensated = self.p.get("compensate_drag", 1.0) * self.braking(i_d, i_q, speed)
        ref_d, ref_q = self._references(self.setpoint + compensated)
        w = m.pole_pairs * speed
        closed = 1.0 - math.exp(-c.bandwidth * c.period)
        k_d, k_q = m.inductance_d * closed / c.period, m.inductance_q * closed / c.period
        r = m.resistance
        u_d = k_d * (ref_d - i_d) - (k_d - r) * i_d + self.integral[0]
        u_q = k_q * (ref_q - i_q) - (k_q - r) * i_q + self.integral[1]
        middle_d = i_d + c.period / (2.0 * m.inductance_d) * (u_d - r * i_d)
        middle_q = i_q + c.period / (2.0 * m.inductance_q) * (u_q - r * i_q)
        v_d = u_d - w * m.inductance_q * middle_q
        v_q = u_q + w * (m.inductance_d * middle_d + m.flux)
        self.voltage = (v_d, v_q)
        self.integral[0] += closed * k_d * (ref_d - i_d)
        self.integral[1] += closed * k_q * (ref_q - i_q)
