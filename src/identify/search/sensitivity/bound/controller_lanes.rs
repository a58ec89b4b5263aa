//! Eight single controllers, as their kernel reads them.

use super::lines::{Lines, rounding};
use crate::identify::search::sensitivity::build::size::CONTROLLER_LANES as LANES;
use pulp::{Simd, WithSimd};

/// Fields per line: `(E − S) √w`, and `S G √w`, turned.
pub(super) mod field {
    pub(crate) const B_RE: usize = 0;
    pub(crate) const B_IM: usize = 1;
    pub(crate) const SG_RE: usize = 2;
    pub(crate) const SG_IM: usize = 3;
    pub(crate) const COUNT: usize = 4;
}

/// The controllers.
#[derive(Debug)]
pub(super) struct ControllerLanes {
    pub fields: Vec<f64>,
    /// What rounding may lose, before the condition of the Gram matrices.
    pub slack: [f64; LANES],
}

impl ControllerLanes {
    pub(super) fn new(lines: &Lines) -> Self {
        Self { fields: vec![0.0; lines.constants.len() * field::COUNT * LANES], slack: [0.0; LANES] }
    }

    /// Reads them by their `1 + L`: per line eight real and eight imaginary parts.
    pub(super) fn fill(&mut self, lines: &Lines, responses: &[f64]) {
        pulp::Arch::new().dispatch(Fill { lines, responses, controllers: self });
    }
}

struct Fill<'a> {
    lines: &'a Lines,
    responses: &'a [f64],
    controllers: &'a mut ControllerLanes,
}

impl WithSimd for Fill<'_> {
    type Output = ();

    /// Pod loops over the lanes, which the compiler vectorises for the dispatched instructions.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { lines, responses, controllers } = self;
        controllers.slack = [0.0; LANES];
        let rows = controllers.fields.chunks_exact_mut(field::COUNT * LANES).zip(responses.chunks_exact(2 * LANES));
        for ((row, response), c) in rows.zip(&lines.constants) {
            let (re, im) = response.split_at(LANES);
            let (e2, w) = (c.error.norm_sqr(), c.root * c.root);
            for lane in 0..LANES {
                let s2 = 1.0 / (re[lane] * re[lane] + im[lane] * im[lane]);
                let (s_re, s_im) = (re[lane] * s2, -im[lane] * s2);
                row[field::B_RE * LANES + lane] = c.error.re - s_re * c.root;
                row[field::B_IM * LANES + lane] = c.error.im - s_im * c.root;
                row[field::SG_RE * LANES + lane] = s_re * c.plant.re - s_im * c.plant.im;
                row[field::SG_IM * LANES + lane] = s_re * c.plant.im + s_im * c.plant.re;
                // 2 Σ w (|E|² + σ²|S|²), with the cancellation in 1 + L of σ = (1 + |L|)/|1 + L|, where |L| ≤ 1 + |1 +
                // L|: σ² ≤ 8 |S|² + 2.
                controllers.slack[lane] += 2.0 * (e2 + s2 * w * (8.0 * s2 + 2.0));
            }
        }
        controllers.slack.iter_mut().for_each(|s| *s *= rounding(lines));
    }
}
