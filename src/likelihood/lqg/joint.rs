//! Plant and belief as one linear system, with what was recorded of it.
//!
//! ```text
//! s⁺ = F s + Γ d + G_w w + G_v v + G_m m,    z = H s + J_v v + J_m m + r
//! ```
//! In the predictor's timing `s = [x; x̂]`,
//!
//! ```text
//! F = [A −BK; LC A−BK−LC],  Γ = [E; told·E],  G_w = [I; 0],  G_v = [0; L],  G_m = [B; 0],
//! ```
//! and the rows of H are `[C 0]` for y and `[0 −K]` for u. In the filter's timing `s = [x; x̂⁻]` with the belief before
//! y was sensed, so that v enters z and s⁺ at one moment: with `T = I − LC`
//!
//! ```text
//! F = [A−BKLC −BKT; (A−BK)LC (A−BK)T],  G_v = [−BKL; (A−BK)L],
//! ```
//! and u has the row `[−KLC −KT]` and `J_v = −KL`. `J_v = I` for a y that is what the person sensed; `J_m = I` for an
//! applied control.

use super::design::{Design, Member, MemberSlope, Plant, Timing};
use nalgebra::DMatrix;

/// The joint system of 2n states and as many outputs as were recorded, or a derivative of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// F, 2n×2n.
    pub f: DMatrix<f64>,
    /// H, channels×2n.
    pub h: DMatrix<f64>,
    /// Covariance of what drives s.
    pub q: DMatrix<f64>,
    /// Covariance of what is added to z.
    pub n: DMatrix<f64>,
    /// Cross-covariance of both, 2n×channels.
    pub x: DMatrix<f64>,
}

/// What K and L make of the system.
struct Blocks {
    f: DMatrix<f64>,
    h: DMatrix<f64>,
    gv: DMatrix<f64>,
    jv: DMatrix<f64>,
}

/// `[top; bottom]`.
fn stacked(top: &DMatrix<f64>, bottom: &DMatrix<f64>) -> DMatrix<f64> {
    let mut m = DMatrix::zeros(top.nrows() + bottom.nrows(), top.ncols());
    m.rows_mut(0, top.nrows()).copy_from(top);
    m.rows_mut(top.nrows(), bottom.nrows()).copy_from(bottom);
    m
}

/// `[left right]`.
fn beside(left: &DMatrix<f64>, right: &DMatrix<f64>) -> DMatrix<f64> {
    stacked(&left.transpose(), &right.transpose()).transpose()
}

impl Design {
    /// Rows of z: y, then u where it was recorded.
    #[must_use]
    pub fn channels(&self) -> usize {
        let [_, m, p, _] = self.sizes();
        p + if self.recorded.control.is_some() { m } else { 0 }
    }

    /// Γ = [E; told·E], 2n×q, which does not depend on the parameters.
    #[must_use]
    pub fn disturbance(&self) -> DMatrix<f64> {
        let e = &self.plant.e;
        stacked(e, &(e * f64::from(u8::from(self.is_told))))
    }

    /// Rows of z with those of y first; none for u where it was not recorded.
    fn rows(&self, y: &DMatrix<f64>, u: &DMatrix<f64>) -> DMatrix<f64> {
        if self.recorded.control.is_some() { stacked(y, u) } else { y.clone() }
    }

    /// J_v's rows of y.
    fn sensed(&self) -> DMatrix<f64> {
        let [_, _, p, _] = self.sizes();
        if self.recorded.instrument.is_none() { DMatrix::identity(p, p) } else { DMatrix::zeros(p, p) }
    }

    fn blocks(&self, k: &DMatrix<f64>, l: &DMatrix<f64>) -> Blocks {
        let [n, m, p, _] = self.sizes();
        let Plant { a, b, c, .. } = &self.plant;
        let (bk, lc) = (b * k, l * c);
        let of_y = beside(c, &DMatrix::zeros(p, n));
        match self.timing {
            Timing::Predictor => Blocks {
                f: stacked(&beside(a, &-&bk), &beside(&lc, &(a - &bk - &lc))),
                h: self.rows(&of_y, &beside(&DMatrix::zeros(m, n), &-k)),
                gv: stacked(&DMatrix::zeros(n, p), l),
                jv: self.rows(&self.sensed(), &DMatrix::zeros(m, p)),
            },
            Timing::Filter => {
                let closed = a - &bk;
                let t = DMatrix::identity(n, n) - &lc;
                Blocks {
                    f: stacked(&beside(&(a - &bk * &lc), &-(&bk * &t)), &beside(&(&closed * &lc), &(&closed * &t))),
                    h: self.rows(&of_y, &beside(&-(k * &lc), &-(k * &t))),
                    gv: stacked(&-(&bk * l), &(&closed * l)),
                    jv: self.rows(&self.sensed(), &-(k * l)),
                }
            }
        }
    }

    /// The derivative of [`Self::blocks`] along (dK, dL), by the product rule.
    fn blocks_slope(&self, [k, l]: [&DMatrix<f64>; 2], [dk, dl]: [&DMatrix<f64>; 2]) -> Blocks {
        let [n, m, p, _] = self.sizes();
        let Plant { a, b, c, .. } = &self.plant;
        let (dbk, dlc) = (b * dk, dl * c);
        let of_y = DMatrix::zeros(p, 2 * n);
        let of_sensed = DMatrix::zeros(p, p);
        match self.timing {
            Timing::Predictor => Blocks {
                f: stacked(&beside(&DMatrix::zeros(n, n), &-&dbk), &beside(&dlc, &(-&dbk - &dlc))),
                h: self.rows(&of_y, &beside(&DMatrix::zeros(m, n), &-dk)),
                gv: stacked(&DMatrix::zeros(n, p), dl),
                jv: self.rows(&of_sensed, &DMatrix::zeros(m, p)),
            },
            Timing::Filter => {
                let lc = l * c;
                let closed = a - b * k;
                let t = DMatrix::identity(n, n) - &lc;
                // d(KL), d(KT), d((A − BK)L), d((A − BK)T).
                let dkl = dk * l + k * dl;
                let dkt = dk * &t - k * &dlc;
                let dcl = &closed * dl - &dbk * l;
                let dct = -(&dbk * &t) - &closed * &dlc;
                Blocks {
                    f: stacked(&beside(&-(b * &dkl * c), &-(b * &dkt)), &beside(&(&dcl * c), &dct)),
                    h: self.rows(&of_y, &beside(&-(&dkl * c), &-&dkt)),
                    gv: stacked(&-(b * &dkl), &dcl),
                    jv: self.rows(&of_sensed, &-&dkl),
                }
            }
        }
    }

    /// G_m and J_m, which do not depend on the parameters.
    fn motor(&self) -> (DMatrix<f64>, DMatrix<f64>) {
        let [n, m, p, _] = self.sizes();
        let applied = if self.recorded.is_applied { DMatrix::identity(m, m) } else { DMatrix::zeros(m, m) };
        (stacked(&self.plant.b, &DMatrix::zeros(n, m)), self.rows(&DMatrix::zeros(p, m), &applied))
    }

    /// The system of a person.
    #[must_use]
    pub fn joint(&self, member: &Member) -> Joint {
        let [n, m, p, _] = self.sizes();
        let Blocks { f, h, gv, jv } = self.blocks(&member.k, &member.l);
        let (gm, jm) = self.motor();
        let mut q = &gv * &member.v * gv.transpose() + &gm * &member.m * gm.transpose();
        let mut of_w = q.view_mut((0, 0), (n, n));
        of_w += &member.w;
        let mut noise = &jv * &member.v * jv.transpose() + &jm * &member.m * jm.transpose();
        if let Some(instrument) = &self.recorded.instrument {
            let mut of_y = noise.view_mut((0, 0), (p, p));
            of_y += instrument;
        }
        if let Some(recorder) = &self.recorded.control {
            let mut of_u = noise.view_mut((p, p), (m, m));
            of_u += recorder;
        }
        let x = &gv * &member.v * jv.transpose() + &gm * &member.m * jm.transpose();
        Joint { f, h, q, n: noise, x }
    }

    /// A derivative of [`Self::joint`], and whether it moves F and H at all.
    pub(super) fn joint_slope(&self, member: &Member, slope: &MemberSlope) -> (Joint, bool) {
        let [n, m, p, _] = self.sizes();
        let (width, channels) = (2 * n, self.channels());
        let mut joint = Joint {
            f: DMatrix::zeros(width, width),
            h: DMatrix::zeros(channels, width),
            q: DMatrix::zeros(width, width),
            n: DMatrix::zeros(channels, channels),
            x: DMatrix::zeros(width, channels),
        };
        if let Some(dw) = &slope.w {
            joint.q.view_mut((0, 0), (n, n)).copy_from(dw);
        }
        if let Some(dm) = &slope.m {
            let (gm, jm) = self.motor();
            joint.q += &gm * dm * gm.transpose();
            joint.n += &jm * dm * jm.transpose();
            joint.x += &gm * dm * jm.transpose();
        }
        if let Some(dv) = &slope.v {
            let Blocks { gv, jv, .. } = self.blocks(&member.k, &member.l);
            joint.q += &gv * dv * gv.transpose();
            joint.n += &jv * dv * jv.transpose();
            joint.x += &gv * dv * jv.transpose();
        }
        let moves_gains = slope.k.is_some() || slope.l.is_some();
        if moves_gains {
            let (no_k, no_l) = (DMatrix::zeros(m, n), DMatrix::zeros(n, p));
            let direction = [slope.k.as_ref().unwrap_or(&no_k), slope.l.as_ref().unwrap_or(&no_l)];
            let Blocks { gv, jv, .. } = self.blocks(&member.k, &member.l);
            let moved = self.blocks_slope([&member.k, &member.l], direction);
            let of_q = &moved.gv * &member.v * gv.transpose();
            let of_n = &moved.jv * &member.v * jv.transpose();
            joint.q += &of_q + of_q.transpose();
            joint.n += &of_n + of_n.transpose();
            joint.x += &moved.gv * &member.v * jv.transpose() + &gv * &member.v * moved.jv.transpose();
            joint.f = moved.f;
            joint.h = moved.h;
        }
        (joint, moves_gains)
    }
}
