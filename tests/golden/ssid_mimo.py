"""Writes ssid_mimo.json: Zhang 2015, examples 4.2 to 4.4, by an implementation that shares nothing with the product.

The responses of example 4.3 (own noise) and the answers of examples 4.2 and 4.3 come from the reference file given as the first
argument; the answers of example 4.4 are computed here: for every candidate the matrices of equations 4.8 and 4.9 are built and solved by
numpy's lstsq, and stability is judged by exact rational arithmetic.

    python3 ssid_mimo.py REFERENCE.json > ssid_mimo.json      (Python 3.12, numpy 2)
"""

import itertools
import json
import sys
from fractions import Fraction

import numpy as np

reference = json.load(open(sys.argv[1]))
theta = 0.02 * np.pi * np.arange(1, 21)
z = np.exp(1j * theta)
truth = np.array([[0.3, 1.0], [0.2, 0.4]])


def response(i):
    # H_11, H_12, H_21, H_22 of each line
    rows = reference["ex4.3"][i - 1]["H_11_12_21_22"]
    return np.array([[[complex(*r[0]), complex(*r[1])], [complex(*r[2]), complex(*r[3])]] for r in rows])


def stable(k, radius):
    """det(D + K Nv) = (z + 1/10 + k11)(z - 1/5 - k22) + k12 k21 has both roots within the radius, strictly; and whether on it."""
    p, q = Fraction(1, 10) + k[0][0], -Fraction(1, 5) - k[1][1]
    a1, a0 = (p + q) / radius, (p * q + k[0][1] * k[1][0]) / radius**2
    return abs(a0) < 1 and abs(a1) < 1 + a0


def cost(k, h):
    """The least-squares cost of an FIR feedforward of order 1."""
    n_y = np.diag([1.0, -1.0])
    rows, right = [], []
    for zk, hk in zip(z, h):
        d = np.diag([zk + 0.1, zk - 0.2])
        inverse = np.linalg.inv(d + k @ n_y)
        a = n_y @ inverse @ np.hstack([np.eye(2), np.eye(2) / zk])
        b = n_y @ inverse @ k - hk
        rows.append(a)
        right.append(-b)
    a, b = np.vstack(rows), np.vstack(right)
    a, b = np.vstack([a.real, a.imag]), np.vstack([b.real, b.imag])
    x = np.linalg.lstsq(a, b, rcond=None)[0]
    return float(np.sum((a @ x - b) ** 2)), x


answers = []
data = {i: response(i) for i in (2, 4, 15)}
for j in range(1, 19):
    axis = [Fraction(-1, 2) + Fraction(2 * k, 1 + j) for k in range(j + 2)]
    kept = [k for k in itertools.product(axis, repeat=4)
            if stable([[k[0], k[1]], [k[2], k[3]]], Fraction(99, 100))]
    candidates = np.array([[float(v) for v in k] for k in kept]).reshape(-1, 2, 2)
    entry = {"j": j, "M": len(kept), "cases": []}
    # All candidates at once, by normal equations, to find the few that lstsq then decides.
    n_y = np.diag([1.0, -1.0])
    d = np.array([np.diag([zk + 0.1, zk - 0.2]) for zk in z])
    inverse = np.linalg.inv(d[None] + (candidates @ n_y)[:, None])
    a = n_y @ inverse @ np.array([np.hstack([np.eye(2), np.eye(2) / zk]) for zk in z])[None]
    a = np.concatenate([a.real, a.imag], axis=1).reshape(len(kept), 80, 4)
    gram = np.einsum("mri,mrj->mij", a, a)
    for i, h in data.items():
        b = h[None] - n_y @ inverse @ candidates[:, None]
        b = np.concatenate([b.real, b.imag], axis=1).reshape(len(kept), 80, 2)
        right = np.einsum("mri,mrj->mij", a, b)
        x = np.linalg.solve(gram, right)
        rough = np.einsum("mrj,mrj->m", b, b) - np.einsum("mij,mij->m", right, x)
        order = np.argsort(rough, kind="stable")[:20]
        decided = sorted((cost(candidates[m], h)[0], int(m)) for m in order)
        best_cost, best = decided[0]
        entry["cases"].append({"i": i, "J": best_cost, "Nfb": candidates[best].ravel().tolist(),
                               "runner_up_J": decided[1][0]})
    answers.append(entry)

json.dump({
    "source": "Zhang 2015, examples 4.2 to 4.4 (own noise); ssid_mimo.py",
    "tool": f"numpy {np.__version__}",
    "tolerance": "counts and arguments exact; costs 1e-9 relative (1e-24 absolute without noise)",
    "ex4.2": reference["ex4.2"],
    "ex4.3": reference["ex4.3"],
    "ex4.4": answers,
}, sys.stdout)
print()
