//! A delay of the senses, by augmentation.
//!
//! What is sensed goes through a line of as many samples as the delay has, `z¹⁺ = Cx + Dd + v`, `zʲ⁺ = zʲ⁻¹`, and the
//! person senses its end. The line is part of the plant's state and of the person's: the person's filter estimates what
//! is on its way, and its gain for the state is `AᵈL` of the undelayed filter. Costs are of the plant's own states, so
//! K has zeros on the line.

use super::design::{Design, Plant, Role};
use nalgebra::DMatrix;

/// A matrix in the upper left corner of zeros.
fn padded(m: &DMatrix<f64>, rows: usize, columns: usize) -> DMatrix<f64> {
    let mut all = DMatrix::zeros(rows, columns);
    all.view_mut((0, 0), m.shape()).copy_from(m);
    all
}

/// The plant with a line of so many samples behind its outputs.
fn with_line(plant: &Plant, samples: usize) -> Plant {
    let (n, p, q) = (plant.a.nrows(), plant.c.nrows(), plant.e.ncols());
    let order = n + samples * p;
    let mut a = padded(&plant.a, order, order);
    a.view_mut((n, 0), (p, n)).copy_from(&plant.c);
    for at in 1..samples {
        a.view_mut((n + at * p, n + (at - 1) * p), (p, p)).fill_with_identity();
    }
    let mut e = padded(&plant.e, order, q);
    e.view_mut((n, 0), (p, q)).copy_from(&plant.d);
    let mut c = DMatrix::zeros(p, order);
    c.view_mut((0, order - p), (p, p)).fill_with_identity();
    Plant { a, b: padded(&plant.b, order, plant.b.ncols()), c, e, d: DMatrix::zeros(p, q) }
}

impl Design {
    /// The same person, who senses everything so many samples later.
    #[must_use]
    pub fn delayed(&self, samples: usize) -> Self {
        if samples == 0 {
            return self.clone();
        }
        let mut design = self.clone();
        let [n, _, p, _] = self.sizes();
        let own = self.internal().a.nrows();
        let line = samples * p;
        design.recorded.rows = Some(self.recorded_rows()).map(|[c, d]| [padded(c, c.nrows(), n + line), d.clone()]);
        design.internal = self.internal.as_ref().map(|internal| with_line(internal, samples));
        design.plant = with_line(&self.plant, samples);
        let mut entry = DMatrix::zeros(n + line, p);
        entry.view_mut((n, 0), (p, p)).fill_with_identity();
        design.on_the_way = Some(entry);
        for term in &mut design.terms {
            let order = match term.role {
                Role::StateWeight | Role::TerminalWeight | Role::PerceivedProcessNoise | Role::InitialCovariance => own,
                Role::ProcessNoise => n,
                _ => continue,
            };
            term.shape = padded(&term.shape, order + line, order + line);
        }
        design
    }
}
