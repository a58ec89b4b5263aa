"""Golden values for src/prediction_error: usage prediction_error.py VIRTUAL_SUBJECTS > prediction_error.json

An independent implementation of the free-lag regression (numpy QR of all columns, HAC sums term by term), on trials of
VIRTUAL_SUBJECTS, and the truth behind them. generate.py there with seed 20260 makes the same people; their plain gains,
which truth.json lacks, come from its random numbers.
"""
import gzip, json, sys
import numpy as np
from scipy import signal

FOLDER = sys.argv[1]


def load(name):
    return np.loadtxt(gzip.open(f"{FOLDER}/{name}", "rt"), delimiter=",", skiprows=1)[:, 1:4].T


def people(seed=20260):
    """The plain gain of every subject, by walking through the random numbers of generate.py."""
    rng, gains = np.random.default_rng(seed), {}
    groups = [("A", 2, 1.0, 40001, (1, 10, 40)), ("GM", 3, 1.0, 3001, (1, 5, 10, 20, 30, 40)),
              ("GN", 3, .35, 3001, (1, 5, 10, 20, 30, 40))]
    ratios = {"A": chirp80()[1][-1] / chirp80()[0][-1], "GM": 4 / 4.4, "GN": 4 / 4.4}
    for name, count, scale, samples, trials in groups:
        for i in range(count):
            tau, lmax, g0, kp, hi, fbz, fbp, delay, rem = [rng.uniform(a, b) for a, b in (
                (6, 14), (.85, .98), (.3, .8), (.4, 1.2), (0, 2), (.5, 2), (1, 4), (.12, .22), (.05, .2))]
            gains[f"{name}{i + 1:02d}"] = g0 * scale * ratios[name]
            for _ in trials:
                rng.standard_normal(samples)
    return gains


def chirp80():
    m1, m2, c1, c2, k1, k2 = 1, .5, .56 * np.pi, .5 * np.pi, .16 * np.pi**2, .5 * np.pi**2
    num = np.array([m1, c1 + c2, k1 + k2])
    return num, np.polyadd(np.polymul([m1, c1, k1], [m2, c2, k2]), [m2 * c2, m2 * k2, 0, 0])


def laws(t, gain, omega):
    """G, Gff, Gfb of a trial, as sampled."""
    ts, num, den = t["sample_time_s"], np.array(t["plant_num"]), np.array(t["plant_den"])
    z = np.exp(1j * omega * ts)
    s = 2 / ts * (z - 1) / (z + 1)
    at = lambda b, a, x: np.polyval(b, x) / np.polyval(a, x)
    if (np.roots(num).real > 0).any():
        w = np.linspace(.05, np.pi, 60)
        iden, target = np.poly([-40.] * 4), np.polyval(den, 1j * w) / np.polyval(num, 1j * w)
        x = np.stack([(1j * w)**p / np.polyval(iden, 1j * w) for p in range(4, -1, -1)], 1)
        inum = np.linalg.lstsq(np.r_[x.real, x.imag], np.r_[target.real, target.imag], rcond=None)[0]
    else:
        w, n = (30. if t["study"] == "chirp80" else 12.), len(den) - len(num)
        inum, iden = den, np.polymul(num, np.poly([-w] * n) / w**n)
    lam, f = t["learning_fraction"], t["feedback"]
    b, a, _ = signal.cont2discrete((num, den), ts)
    ff = lam * at(inum, iden, s) + (1 - lam) * gain
    fb = f["kp"] * (s + f["zero"]) / ((s + f["pole"]) * (f["lag_s"] * s + 1))
    return at(b.squeeze(), a, z), ff, fb * z**-max(1, round(f["delay_s"] / ts))


AHEAD, BEHIND, TERMS, LAGS, NA, HAC, FACTOR, TS = 10, 25, 8, range(4, 18), 2, 25, 1.15, .02


def window():
    return np.linalg.qr(np.vander(np.linspace(-1, 1, AHEAD + BEHIND), TERMS, increasing=True))[0]


def own_columns(r, rows, zero):
    lags = np.stack([r[rows - k] for k in range(-AHEAD, BEHIND)], 1) @ window()
    return np.c_[lags, signal.lfilter([1], [1, -zero], r)[rows]] if zero else lags


def estimate(trials, zero):
    parts, weights = [], np.ones(len(trials))
    for r, u, y in trials:
        rows = np.arange(BEHIND - 1, len(r) - AHEAD)
        shared = np.stack([u[rows - k] for k in range(1, NA + 1)] + [(r - y)[rows - k] for k in LAGS], 1)
        parts.append((own_columns(r, rows, zero), shared, u[rows]))
    k, s = parts[0][0].shape[1], parts[0][1].shape[1]
    for _ in range(100):
        stacked, target = [], []
        for w, (own, shared, b) in zip(weights, parts):
            q = np.linalg.qr(own / np.linalg.norm(own, axis=0))[0]
            stacked.append(np.sqrt(w) * (shared - q @ (q.T @ shared)))
            target.append(np.sqrt(w) * (b - q @ (q.T @ b)))
        common = np.linalg.lstsq(np.vstack(stacked), np.concatenate(target), rcond=None)[0]
        own = [np.linalg.lstsq(o, b - sh @ common, rcond=None)[0] for o, sh, b in parts]
        residuals = [b - o @ x - sh @ common for (o, sh, b), x in zip(parts, own)]
        new = np.array([len(e) / (e @ e) for e in residuals])
        done, weights = np.max(abs(new / weights - 1)) < 1e-11, new
        if done or len(trials) == 1:
            break
    # One regression of everything, whose sandwich is the covariance.
    n, total = sum(len(e) for e in residuals), k * len(trials) + s
    x, e, at, blocks = np.zeros((n, total)), np.zeros(n), 0, []
    for i, ((o, sh, _), w, res) in enumerate(zip(parts, weights, residuals)):
        rows = slice(at, at + len(res))
        x[rows, i * k:(i + 1) * k], x[rows, k * len(trials):] = o * np.sqrt(w), sh * np.sqrt(w)
        e[rows], at = res * np.sqrt(w), at + len(res)
        blocks.append(rows)
    scale = np.linalg.norm(x, axis=0)
    q, triangle = np.linalg.qr(x / scale)
    meat = np.zeros((total, total))
    for rows in blocks:
        g = q[rows] * e[rows, None]
        meat += g.T @ g
        for lag in range(1, HAC + 1):
            c = g[lag:].T @ g[:-lag]
            meat += (1 - lag / (HAC + 1)) * (c + c.T)
    inverse = np.linalg.inv(triangle) / scale[:, None]
    return own, common, inverse @ meat @ inverse.T, k, zero, residuals


def norms(found, i, plant, omega):
    own, common, covariance, k, zero, _ = found
    q = np.exp(-1j * omega * TS)
    a = 1 - sum(common[j] * q**(j + 1) for j in range(NA))
    f = np.stack([q**j for j in range(-AHEAD, BEHIND)], 1) @ window()
    f = np.c_[f, 1 / (1 - zero * q)] if zero else f
    e, da = np.stack([q**j for j in LAGS], 1), np.stack([q**(j + 1) for j in range(NA)], 1)
    ff, fb, total = f @ own[i] / a, e @ common[NA:] / a, covariance.shape[0]
    out, start = [], total - len(common)
    for x, slope_own, slope_a, slope_e, factor in (
            (ff * plant - 1, f / a[:, None], ff[:, None] * da / a[:, None], 0 * e, plant),
            (fb, 0 * f, fb[:, None] * da / a[:, None], e / a[:, None], 1 + 0 * plant)):
        direction = (np.conj(x) / abs(x) * factor)[:, None]
        g = np.zeros(total)
        g[i * k:(i + 1) * k] = np.mean(direction * slope_own, 0).real
        g[start:] = np.mean(direction * np.c_[slope_a, slope_e], 0).real
        out += [np.mean(abs(x)), FACTOR * np.sqrt(g @ covariance @ g)]
    return out


def main():
    truth = [t for t in json.load(open(f"{FOLDER}/truth.json")) if t["group"] in ("msd2", "gm", "gn")]
    gains, trials = people(), []
    for t in truth:
        top = .65 if t["study"] == "chirp80" else .5
        band = 2 * np.pi * np.array([1 / t["duration_s"], top])
        fine = band[0] + (band[1] - band[0]) * (np.arange(4000) + .5) / 4000
        lines = band[0] + (band[1] - band[0]) * np.arange(10) / 9
        g, ff, fb = laws(t, gains[t["subject"]], fine)
        trials.append({"file": t["file"], "norm_feedforward_plant_minus_one": float(np.mean(abs(ff * g - 1))),
                       "norm_feedback": float(np.mean(abs(fb))), "omega_rad_s": list(lines),
                       "feedback": [[z.real, z.imag] for z in laws(t, gains[t["subject"]], lines)[2]]})
    estimates = []
    for subject in ("GM01", "GN02"):
        of = [t for t in truth if t["subject"] == subject]
        zero = np.exp(-2.2 * TS) if subject == "GM01" else 0.
        for name, chosen in (("one", of[-1:]), ("six", of)):
            found = estimate([load(t["file"]) for t in chosen], zero)
            fine = 2 * np.pi * (1 / 60 + (.5 - 1 / 60) * (np.arange(4000) + .5) / 4000)
            b, a, _ = signal.cont2discrete((chosen[0]["plant_num"], chosen[0]["plant_den"]), TS)
            z = np.exp(1j * fine * TS)
            plant = np.polyval(b.squeeze(), z) / np.polyval(a, z)
            estimates.append({"subject": subject, "trials": name, "autoregressive": list(found[1][:NA]),
                              "feedback": list(found[1][NA:]), "variance": [float(e @ e / len(e)) for e in found[5]],
                              "norms": [norms(found, i, plant, fine) for i in range(len(chosen))]})
    print(json.dumps({
        "source": "numpy and scipy, an implementation that shares no code with this one",
        "command": "python3 prediction_error.py ../data/virtual_subjects > prediction_error.json",
        "tolerance": "1e-6 of values, 1e-4 of standard errors; the norms are ‖Gff G − 1‖, its standard error, ‖Gfb‖, its",
        "truth": trials, "estimates": estimates}))


main()
