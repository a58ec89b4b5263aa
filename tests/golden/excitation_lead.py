"""Writes excitation_lead.json: the compensator of largest band-limited flatness gain (Qiu 2021) for the linear drive, by scipy's differential
evolution and Nelder-Mead over the same box, with the spectrum of the PRTS by its closed form and stability by the roots of the loop.

    python3 excitation_lead.py > excitation_lead.json      (Python 3.12, numpy 2, scipy 1.17)
"""

import json

import numpy as np
from scipy.optimize import differential_evolution, minimize

m, c, T = 10.0, 50.0, 1e-3
decay = np.exp(-c / m * T)
b1 = m / c**2 * np.expm1(-c / m * T) + T / c
b2 = -m / c**2 * np.expm1(-c / m * T) - T / c * decay


def band(f_ub):
    n = np.arange(1, 2 * np.ceil((f_ub * 48.4 + 1) / 2), 2)
    theta = 2 * np.pi * n / 48400
    z = np.exp(1j * theta)
    power = 324 * (np.sin(np.pi * n / 242) / np.sin(np.pi * n / 48400)) ** 2
    return power, z, (b1 * z + b2) / ((z - 1) * (z - decay))


def flatness(s):
    return np.exp(np.mean(np.log(s))) / np.mean(s)


def gain(x, power, z, plant, strict):
    K, fz, fp = np.exp(x)
    if strict and fz > fp:
        return 0.0
    k, wz, wp = 2 / T, 2 * np.pi * fz, 2 * np.pi * fp
    num, den = K * np.array([k + wz, wz - k]) / (k + wp), np.array([1, (wp - k) / (k + wp)])
    loop = np.polyadd(np.polymul([1, -1 - decay, decay], den), np.polymul([b1, b2], num))
    if np.max(np.abs(np.roots(loop))) >= 1:
        return 0.0
    open_loop = plant * np.polyval(num, z) / np.polyval(den, z)
    return flatness(np.abs(open_loop / (1 + open_loop)) ** 2 * power) / flatness(power)


answers = []
for f_ub in (5.0, 10.0):
    for strict in (False, True):
        parts = band(f_ub)
        typical = 1 / abs(parts[2][-1])
        corner = [np.log(1e-3 * f_ub), np.log(450.0)]
        box = [[np.log(1e-4 * typical), np.log(1e4 * typical)], corner, corner]
        cost = lambda x: -gain(x, *parts, strict)
        best = min(
            (differential_evolution(cost, box, seed=seed, popsize=30, maxiter=600, tol=1e-12) for seed in (1, 2, 3)),
            key=lambda r: r.fun,
        )
        best = minimize(cost, best.x, method="Nelder-Mead", bounds=box, options=dict(xatol=1e-10, fatol=1e-14, maxfev=20000))
        K, fz, fp = np.exp(best.x)
        case = {"band_hz": f_ub, "zero_below_pole": strict}
        answers.append(case | {"gain": K, "zero_hz": fz, "pole_hz": fp, "blsfg": -best.fun})
tolerance = "blsfg relative 1e-6, 5e-6 with zero_below_pole"
print(json.dumps({"source": "excitation_lead.py", "tolerance": tolerance, "answers": answers}, indent=1))
