"""Writes excitation_limited.json: the compensator of largest band-limited flatness gain (Qiu 2021) for the linear drive under limits, by scipy's
differential evolution with the limits as constraints, then SLSQP along the ridge on which the pole can move almost for nothing. The spectrum of
the PRTS is its closed form, decay and stability come from the roots of the loop, the norm of SP from fine grids around them, and the peak force
from a recursion over two periods from rest.

    python3 excitation_limited.py > excitation_limited.json      (Python 3.12, numpy 2, scipy 1.17; some minutes)
"""

import json

import numpy as np
from scipy.optimize import NonlinearConstraint, differential_evolution, minimize
from scipy.signal import lfilter

m, c, chip, amplitude = 10.0, 50.0, 0.2, 0.02


class Drive:
    """The loop at a sample time, and the lines of a band."""

    def __init__(self, T, f_ub):
        self.T = T
        x = c / m * T
        term = lambda k: (-x) ** k / np.prod(np.arange(1.0, k + 3))
        b1 = T**2 / m * sum(term(k) for k in range(20))
        b2 = T**2 / m * sum((k + 1) * term(k) for k in range(20))
        self.num, self.den = np.array([b1, b2]), np.array([1, -1 - np.exp(-x), np.exp(-x)])
        held = round(chip / T)
        n, N = np.arange(1, 2 * np.ceil((f_ub * 48.4 + 1) / 2), 2), 242 * held
        self.power = 324 * (np.sin(np.pi * n / 242) / np.sin(np.pi * n / N)) ** 2
        self.z = np.exp(2j * np.pi * n / N)
        self.plant = np.polyval(self.num, self.z) / np.polyval(self.den, self.z)
        s = [0, 0, 0, 0, 1]
        while len(s) < 242:
            s.append((2 * s[-5] + s[-1]) % 3)
        one = np.repeat(np.where(np.array(s) == 2, -1, s), held).astype(float)
        self.reference = amplitude * np.concatenate([one, one])
        self.grid = np.concatenate([[0.0], np.geomspace(1e-3, np.pi / T, 600)])
        corner = [np.log(1e-3 * f_ub), np.log(0.45 / T)]
        typical = 1 / abs(self.plant[-1])
        self.box = [[np.log(1e-4 * typical), np.log(1e4 * typical)], corner, corner]

    def compensator(self, x):
        K, fz, fp = np.exp(x)
        k, wz, wp = 2 / self.T, 2 * np.pi * fz, 2 * np.pi * fp
        return K * np.array([k + wz, wz - k]) / (k + wp), np.array([1, (wp - k) / (k + wp)])

    def loop(self, x):
        num, den = self.compensator(x)
        return np.polyadd(np.polymul(self.den, den), np.polymul(self.num, num))

    def slowest(self, x):
        return -np.log(np.max(np.abs(np.roots(self.loop(x))))) / self.T

    def gain(self, x):
        if not self.slowest(x) > 0:
            return 1e-3
        num, den = self.compensator(x)
        open_loop = self.plant * np.polyval(num, self.z) / np.polyval(den, self.z)
        flatness = lambda s: np.exp(np.mean(np.log(s))) / np.mean(s)
        return flatness(np.abs(open_loop / (1 + open_loop)) ** 2 * self.power) / flatness(self.power)

    def norm(self, x):
        """The largest |SP|; of an unstable loop something large."""
        roots = np.roots(self.loop(x))
        if np.max(np.abs(roots)) >= 1:
            return 1e3
        _, den = self.compensator(x)

        def size(w):
            z = np.exp(1j * w * self.T)
            return np.abs(np.polyval(self.num, z) * np.polyval(den, z) / np.polyval(self.loop(x), z))

        s = np.log(roots[np.abs(roots) > 1e-12].astype(complex)) / self.T
        near = np.concatenate([v.imag + np.abs(v.real) * np.linspace(-3, 3, 61) for v in s if v.imag >= 0])
        w = np.sort(np.concatenate([self.grid, near[(near >= 0) & (near <= np.pi / self.T)]]))
        for _ in range(4):
            values = size(w)
            best = int(np.argmax(values))
            w = np.linspace(w[max(best - 1, 0)], w[min(best + 1, len(w) - 1)], 401)
        return float(np.max(values))

    def force(self, x):
        if not self.slowest(x) > 0:
            return 1e9
        num, _ = self.compensator(x)
        return float(np.max(np.abs(lfilter(np.polymul(self.den, num), self.loop(x), self.reference))))


def solve(drive, limits):
    rows = [lambda x: drive.slowest(x) - limits["decay_per_s"]]
    if "disturbance_norm" in limits:
        rows.append(lambda x: np.log(limits["disturbance_norm"] / drive.norm(x)))
    if "force" in limits:
        rows.append(lambda x: np.log(limits["force"] / drive.force(x)))
    cost = lambda x: -np.log(drive.gain(x))
    left = lambda x: np.array([row(x) for row in rows])
    best = [0.0, None]

    def climb(start, box):
        for _ in range(3):
            options = dict(maxiter=300, ftol=1e-15, eps=1e-7)
            end = minimize(cost, start, method="SLSQP", bounds=box, constraints=[{"type": "ineq", "fun": left}], options=options).x
            end = np.clip(end, [b[0] for b in box], [b[1] for b in box])
            if left(end).min() < -1e-8:
                break
            if cost(end) < best[0]:
                best[:] = [cost(end), end]
            start = end
        return start

    for seed in (1, 2, 3):
        limited = [NonlinearConstraint(row, 0, np.inf) for row in rows]
        found = differential_evolution(cost, drive.box, seed=seed, popsize=12, maxiter=100, constraints=limited, polish=False)
        climb(found.x, drive.box)
    for direction in (-0.4, 0.4):
        x = best[1].copy()
        while drive.box[2][0] < x[2] < drive.box[2][1]:
            x[2] = np.clip(x[2] + direction, *drive.box[2])
            x = climb(x, drive.box[:2] + [[x[2], x[2]]])
    climb(best[1], drive.box)
    return best[1]


cases = []
decay = np.pi * 2 / 48.4
for f_ub, proportional in ((5.0, 9051.91623435142), (10.0, 38343.50741779535)):
    drive = Drive(1e-3, f_ub)
    own = drive.norm(np.log([proportional, 1.0, 1.0]))
    cases.append((drive, f_ub, {"decay_per_s": decay}))
    cases.append((drive, f_ub, {"decay_per_s": decay, "disturbance_norm": own}))
    cases.append((Drive(5e-3, f_ub), f_ub, {"decay_per_s": decay, "disturbance_norm": 0.001, "force": 60.0 * f_ub if f_ub < 7 else 1000.0}))
answers = []
for drive, f_ub, limits in cases:
    x = solve(drive, limits)
    K, fz, fp = np.exp(x)
    case = {"sample_time_s": drive.T, "band_hz": f_ub, "limits": limits, "gain": K, "zero_hz": fz, "pole_hz": fp, "blsfg": drive.gain(x)}
    answers.append(case | {"disturbance_norm": drive.norm(x), "slowest_decay_per_s": drive.slowest(x), "force": drive.force(x)})
tolerance = "relative: blsfg of the best compensators 1e-5, as neither search is a proof; of the one given 1e-9, norm and decay 1e-6, force 1e-8"
print(json.dumps({"source": "excitation_limited.py", "tolerance": tolerance, "answers": answers}, indent=1))
