"""Writes zero_order_hold.json: sampled plants at 50 digits, by partial fractions of G(s)/s (not by a matrix exponential).

    python3 tests/golden/zero_order_hold.py > tests/golden/zero_order_hold.json      (mpmath 1.3)
"""

import json
from mpmath import mp, mpf, mpc, exp, pi, polyroots, polyval

mp.dps = 50
p5 = [mpf(1), mpf("3.6"), mpf(4)]
m1, m2, c1, c2, k1, k2 = mpf(1), mpf("0.5"), mpf("0.56") * pi, mpf("0.5") * pi, mpf("0.16") * pi**2, mpf("0.5") * pi**2
CASES = [
    ("minimum_phase", "0.02", [mpf(2), mpf("4.4")], p5),
    ("nonminimum_phase", "0.02", [mpf(-2), mpf("4.4")], p5),
    ("slow_nonminimum_phase", "0.02", [mpf("-5.5"), mpf("4.4")], p5),
    *[
        (
            "two_mass",
            period,
            [m1, c1 + c2, k1 + k2],
            [m1 * m2, m1 * c2 + m2 * c1 + m2 * c2, m1 * k2 + m2 * k1 + m2 * k2 + c1 * c2, c1 * k2 + c2 * k1, k1 * k2],
        )
        for period in ("0.02", "0.002")
    ],
]


def sampled(num, den, period):
    """Numerator and monic denominator in descending powers of z."""
    poles = polyroots(den, maxsteps=500, extraprec=500)
    slope = [c * (len(den) - 1 - i) for i, c in enumerate(den[:-1])]
    # Step response: y(t) = G(0) + sum of residues of G(s)/s times e^{pt}.
    residues = [polyval(num, p) / (p * polyval(slope, p)) for p in poles]
    step = lambda t: num[-1] / den[-1] + sum(r * exp(p * t) for r, p in zip(residues, poles))
    n = len(poles)
    pulse = [step(k * period) - (step((k - 1) * period) if k else 0) for k in range(n + 1)]
    zden = [mpc(1)]
    for p in poles:
        zden = [a - exp(p * period) * b for a, b in zip(zden + [mpc(0)], [mpc(0)] + zden)]
    znum = [sum(zden[j] * pulse[k - j] for j in range(k + 1)) for k in range(n + 1)]
    assert abs(znum[0]) < mpf(10) ** -45
    return [c.real for c in znum[1:]], [c.real for c in zden]


out = {"source": "partial fractions at 50 digits, tests/golden/zero_order_hold.py", "tool": "mpmath 1.3.0", "tolerance": 1e-12, "cases": []}
for name, text, num, den in CASES:
    period = mpf(text)
    znum, zden = sampled(num, den, period)
    response = []
    for omega in ("0.1", "1", "3", "10", "60"):
        z = exp(mpc(0, 1) * mpf(omega) * period)
        value = polyval(znum, z) / polyval(zden, z)
        response.append({"omega_rad_s": float(omega), "h": [float(value.real), float(value.imag)]})
    out["cases"].append(
        {"plant": name, "sample_time_s": float(text), "num": [float(c) for c in znum], "den": [float(c) for c in zden], "response": response}
    )
print(json.dumps(out, indent=1))
