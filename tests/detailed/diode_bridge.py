"""A switched six-diode bridge on a PMSM, in phase quantities: reference for the averaged one."""

from __future__ import annotations

import math

import numba
import numpy as np


@numba.njit
def bridge(pairs, psi, ld, lq, r, speed, link_voltage, settle, measure, dt=1e-7, sharp=0.3):
    """Return mean torque, N m, mean current into the link, A, and mean i_d, i_q, A.

    A leg follows its current: lower diode while it flows into the machine, upper one while it flows out,
    anything between at less than about ``sharp`` amperes.  Explicit trapezoidal rule.
    """
    w = pairs * speed
    i_d = i_q = 0.0
    sums = np.zeros(4)
    count = 0
    legs = np.zeros(3)
    for k in range(int((settle + measure) / dt)):
        rates = np.zeros(4)
        here_d, here_q = i_d, i_q
        link = 0.0
        for stage in range(2):
            angle = w * dt * (k + stage)
            c, s = math.cos(angle), math.sin(angle)
            alpha, beta = c * here_d - s * here_q, s * here_d + c * here_q
            phases = (alpha, -0.5 * alpha + 0.75**0.5 * beta, -0.5 * alpha - 0.75**0.5 * beta)
            flow = 0.0
            for j in range(3):
                legs[j] = 0.5 * link_voltage * (1.0 - math.tanh(phases[j] / sharp))
                flow -= phases[j] * legs[j] / link_voltage
            if stage == 0:
                link = flow
            v_alpha = (2.0 * legs[0] - legs[1] - legs[2]) / 3.0
            v_beta = (legs[1] - legs[2]) / 3.0**0.5
            v_d, v_q = c * v_alpha + s * v_beta, c * v_beta - s * v_alpha
            rates[2 * stage] = (v_d - r * here_d + w * lq * here_q) / ld
            rates[2 * stage + 1] = (v_q - r * here_q - w * (ld * here_d + psi)) / lq
            here_d, here_q = i_d + dt * rates[0], i_q + dt * rates[1]
        if k * dt >= settle:
            sums[0] += 1.5 * pairs * (psi + (ld - lq) * i_d) * i_q
            sums[1] += link
            sums[2] += i_d
            sums[3] += i_q
            count += 1
        i_d += 0.5 * dt * (rates[0] + rates[2])
        i_q += 0.5 * dt * (rates[1] + rates[3])
    return sums / count
