"""Writes inverse_margins.json: the margin t* of random gains of several inputs, by an implementation that shares nothing with the product.

The equalities are solved by elimination with full pivoting at 40 digits, and `max t` with `Q >= tI`, `R >= tI`, `tr Q + tr R = n + m` by a barrier
method in their null space, to a gap of 1e-12.

    python3 inverse_margins.py 160 60 > inverse_margins.json      (Python 3.11, mpmath 1.3, three minutes)
"""

import json, random, sys
from mpmath import mp, mpf, matrix, eye, zeros, log, sqrt

mp.dps = 40


def T(a):
    return a.T


def null_space(rows, cols):
    # rows: list of lists; full pivoting
    a = [r[:] for r in rows]
    nr = len(a)
    perm = list(range(cols))
    rank = 0
    big = max((abs(x) for r in a for x in r), default=mpf(0))
    while rank < min(nr, cols):
        best = mpf(0)
        bi = bj = rank
        for i in range(rank, nr):
            for j in range(rank, cols):
                if abs(a[i][j]) > best:
                    best = abs(a[i][j])
                    bi, bj = i, j
        if best <= big * mpf(10) ** -28:
            break
        a[rank], a[bi] = a[bi], a[rank]
        for r in a:
            r[rank], r[bj] = r[bj], r[rank]
        perm[rank], perm[bj] = perm[bj], perm[rank]
        p = a[rank][rank]
        a[rank] = [x / p for x in a[rank]]
        for i in range(nr):
            if i != rank and a[i][rank] != 0:
                f = a[i][rank]
                a[i] = [x - f * y for x, y in zip(a[i], a[rank])]
        rank += 1
    basis = []
    for k in range(rank, cols):
        v = [mpf(0)] * cols
        v[perm[k]] = mpf(1)
        for i in range(rank):
            v[perm[i]] = -a[i][k]
        basis.append(v)
    return basis


def chol(m):
    n = m.rows
    L = zeros(n, n)
    for j in range(n):
        s = m[j, j] - sum(L[j, k] ** 2 for k in range(j))
        if s <= 0:
            return None
        L[j, j] = sqrt(s)
        for i in range(j + 1, n):
            L[i, j] = (m[i, j] - sum(L[i, k] * L[j, k] for k in range(j))) / L[j, j]
    return L


def tr(m):
    return sum(m[i, i] for i in range(m.rows))


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def margin(A, B, K, disc):
    n, m = B.rows, B.cols
    Ac = A - B * K
    syms = []
    for o, isP in ((n, True), (m, False)):
        for j in range(o):
            for i in range(j + 1):
                e = zeros(o, o)
                e[i, j] = mpf(1)
                e[j, i] = mpf(1)
                syms.append((e, zeros(m, m)) if isP else (zeros(n, n), e))
    eqs = []
    for P, R in syms:
        E = (T(B) * P * Ac if disc else T(B) * P) - R * K
        eqs.append([E[i, j] for i in range(m) for j in range(n)])
    rows = [[eqs[u][e] for u in range(len(syms))] for e in range(n * m)]
    basis = null_space(rows, len(syms))
    Qs = []
    Rs = []
    for v in basis:
        P = zeros(n, n)
        R = zeros(m, m)
        for c, (p, r) in zip(v, syms):
            if c != 0:
                P += p * c
                R += r * c
        Q = (P - T(Ac) * P * Ac - T(K) * R * K) if disc else (-(T(Ac) * P) - P * Ac - T(K) * R * K)
        s = sqrt(dot(Q, Q) + dot(R, R))
        Qs.append(Q / s)
        Rs.append(R / s)
    k = len(Qs)
    tau = [tr(Qs[i]) + tr(Rs[i]) for i in range(k)]
    nn = sum(x * x for x in tau)
    if nn < mpf(10) ** -30:
        return None, k
    z0 = [x * (n + m) / nn for x in tau]
    piv = max(range(k), key=lambda i: abs(tau[i]))
    dirs = []
    for i in range(k):
        if i == piv:
            continue
        v = [mpf(0)] * k
        v[i] = mpf(1)
        v[piv] = -tau[i] / tau[piv]
        dirs.append(v)
    comb = lambda M, v: sum((M[i] * v[i] for i in range(k) if v[i] != 0), zeros(M[0].rows, M[0].cols))
    base = (comb(Qs, z0), comb(Rs, z0))
    D = [(comb(Qs, v), comb(Rs, v)) for v in dirs]
    D.append((-eye(n), -eye(m)))
    d = len(D)
    x = [mpf(0)] * d
    bound = max(sqrt(dot(b, b)) for b in base)
    x[-1] = -bound * 2 - 1
    slack = lambda x: [
        base[b] + sum((D[i][b] * x[i] for i in range(d)), zeros(base[b].rows, base[b].cols)) for b in (0, 1)
    ]

    def val(x, mu):
        s = slack(x)
        ls = [chol(q) for q in s]
        if any(l is None for l in ls):
            return None
        return -x[-1] / mu - 2 * sum(log(l[i, i]) for l in ls for i in range(l.rows))

    mu = mpf(10)
    last = mpf(10) ** -13
    while True:
        for it in range(80):
            s = slack(x)
            inv = [q**-1 for q in s]
            SD = [[inv[b] * D[i][b] for b in (0, 1)] for i in range(d)]
            g = matrix([-sum(tr(SD[i][b]) for b in (0, 1)) for i in range(d)])
            g[d - 1] -= 1 / mu
            H = zeros(d, d)
            for i in range(d):
                for j in range(i + 1):
                    h = sum(
                        SD[i][b][p, q] * SD[j][b][q, p]
                        for b in (0, 1)
                        for p in range(s[b].rows)
                        for q in range(s[b].rows)
                    )
                    H[i, j] = h
                    H[j, i] = h
            st = mp.cholesky_solve(H, -g)
            dec = -sum(g[i] * st[i] for i in range(d))
            if dec < mpf(10) ** -8:
                break
            f0 = val(x, mu)
            a = mpf(1)
            if dec > mpf(1) / 16:
                while True:
                    y = [x[i] + a * st[i] for i in range(d)]
                    f = val(y, mu)
                    if f is not None and f <= f0 - mpf("0.1") * a * dec:
                        break
                    a /= 2
            x = [x[i] + a * st[i] for i in range(d)]
        if mu <= last:
            break
        mu *= mpf("0.03")
    return x[-1], k


def rnd(r, c, g, dec=3):
    return matrix([[mpf(round(g.uniform(-1, 1), dec)) for _ in range(c)] for _ in range(r)])


def flt(M):
    return [[float(M[i, j]) for j in range(M.cols)] for i in range(M.rows)]


def stable(M, disc):
    e = mp.eig(M, left=False, right=False)
    return all((abs(x) < 0.98) if disc else (x.real < -0.02) for x in e)


def make(g):
    while True:
        n = g.randint(2, 4)
        m = g.randint(2, n)
        disc = g.random() < 0.5
        A = rnd(n, n, g)
        B = rnd(n, m, g)
        q = rnd(n, n, g)
        r = rnd(m, m, g)
        Q = q * q.T + eye(n) * mpf("0.3")
        R = r * r.T + eye(m) * mpf("0.3")
        K = lqr(A, B, Q, R, disc)
        if K is None:
            continue
        N = rnd(m, n, g)
        nk = sqrt(dot(K, K))
        return n, m, disc, A, B, K, N * nk


def lqr(A, B, Q, R, disc):
    n = A.rows
    if disc:
        P = Q.copy()
        for _ in range(400):
            G = R + T(B) * P * B
            K = G**-1 * (T(B) * P * A)
            P2 = Q + T(A) * P * (A - B * K)
            P2 = (P2 + T(P2)) / 2
            d = max(abs(x) for x in (P2 - P))
            P = P2
            if d < mpf(10) ** -12:
                return K
        return None
    # sign function of the Hamiltonian
    G = B * R**-1 * T(B)
    Z = zeros(2 * n, 2 * n)
    for i in range(n):
        for j in range(n):
            Z[i, j] = A[i, j]
            Z[i, n + j] = -G[i, j]
            Z[n + i, j] = -Q[i, j]
            Z[n + i, n + j] = -A[j, i]
    for _ in range(60):
        Y = (Z + Z**-1) / 2
        d = max(abs(x) for x in (Y - Z))
        Z = Y
        if d < mpf(10) ** -15:
            break
    W = Z
    L = zeros(2 * n, n)
    Rh = zeros(2 * n, n)
    for i in range(n):
        for j in range(n):
            L[i, j] = W[i, n + j]
            L[n + i, j] = W[n + i, n + j] + (1 if i == j else 0)
            Rh[i, j] = -(W[i, j] + (1 if i == j else 0))
            Rh[n + i, j] = -W[n + i, j]
    P = (T(L) * L) ** -1 * (T(L) * Rh)
    return R**-1 * (T(B) * P)


def rk(K, dig=None):
    return matrix(
        [
            [mpf(float(K[i, j])) if dig is None else mpf(float(mp.nstr(K[i, j], dig))) for j in range(K.cols)]
            for i in range(K.rows)
        ]
    )


def stored(rows):
    return matrix([[mpf(float(x)) for x in row] for row in rows.tolist()])


def cases(count, near):
    """`count` gains around optimal ones, then `near` gains bisected towards the border between the verdicts."""
    g = random.Random(20260805)
    out = []
    while len(out) < count + near:
        n, m, disc, A, B, K0, N = make(g)
        A, B = stored(A), stored(B)
        if len(out) < count:
            K = rk(K0 + N * mpf(g.choice([0, 0.05, 0.15, 0.3, 0.6])), 6)
            if not stable(A - B * K, disc):
                continue
        else:
            lo, hi = mpf(0), mpf("0.8")
            if not stable(A - B * (K0 + N * hi), disc):
                continue
            t, _ = margin(A, B, rk(K0 + N * hi), disc)
            if t is None or t > 0:
                continue
            want = mpf(10) ** -g.uniform(2, 6.5) * g.choice([-1, 1])
            ok = True
            for _ in range(28):
                mid = (lo + hi) / 2
                if not stable(A - B * (K0 + N * mid), disc):
                    ok = False
                    break
                t, _ = margin(A, B, rk(K0 + N * mid), disc)
                lo, hi = (mid, hi) if t > want else (lo, mid)
                if abs(t - want) < abs(want) / 5:
                    break
            if not ok:
                continue
            K = rk(K0 + N * mid)
        t, unknowns = margin(A, B, K, disc)
        if t is not None:
            out.append(
                {"discrete": disc, "A": flt(A), "B": flt(B), "K": flt(K), "t_star": float(t), "unknowns": unknowns}
            )
    return out


if __name__ == "__main__":
    about = {
        "source": "random plants with several inputs and stabilising gains, part of them moved to the border of optimality; the numbers are exact as "
        "written",
        "tool": "mpmath at 40 digits",
        "command": "python3 inverse_margins.py 160 60 > inverse_margins.json",
        "tolerance": "t_star 1e-8 absolute: the answers compared are of double precision",
    }
    lines = ",\n".join(json.dumps(case, separators=(",", ":")) for case in cases(int(sys.argv[1]), int(sys.argv[2])))
    print(json.dumps(about)[:-1] + ', "cases": [\n' + lines + "\n]}")
