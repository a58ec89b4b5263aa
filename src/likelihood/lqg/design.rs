//! What is known of the person beforehand, and the person that belongs to given parameters.

use crate::control::lyapunov::{Clock, Lyapunov};
use crate::control::riccati::Riccati;
use crate::num::linalg::{solve_symmetric, symmetric};
use nalgebra::DMatrix;

/// A plant in sampled time, `x⁺ = Ax + B(u + m) + Ed + w`, `y = Cx + v`.
#[derive(Debug, Clone, PartialEq)]
pub struct Plant {
    /// A, n×n.
    pub a: DMatrix<f64>,
    /// B, n×m: what the person does.
    pub b: DMatrix<f64>,
    /// C, p×n: what the person senses.
    pub c: DMatrix<f64>,
    /// E, n×q: what the experimenter does.
    pub e: DMatrix<f64>,
}

/// Which matrix a term is part of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Q, n×n: what the person weighs of the states.
    StateWeight,
    /// W_p, n×n: the process noise that the person's filter is made for.
    PerceivedProcessNoise,
    /// W, n×n: the true process noise.
    ProcessNoise,
    /// V, p×p: the true noise of the senses.
    MeasurementNoise,
    /// M, m×m: the true noise of the motor, added to the control.
    MotorNoise,
}

/// A term `e^θ · shape` of one of the matrices.
#[derive(Debug, Clone, PartialEq)]
pub struct Term {
    /// Its name.
    pub name: String,
    /// The matrix that it is part of.
    pub role: Role,
    /// Symmetric and positive semidefinite.
    pub shape: DMatrix<f64>,
    /// The coefficient where it is known and not estimated; it may be zero then.
    pub held: Option<f64>,
    /// Where the user starts it.
    pub start: Option<f64>,
}

/// When the person's belief takes in what is sensed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Timing {
    /// `u_k` rests on y up to k − 1: `x̂⁺ = Ax̂ + Bu + L(y − Cx̂)`.
    Predictor,
    /// `u_k` rests on y up to k: `x̂ = x̂⁻ + L(y − Cx̂⁻)`, `x̂⁻⁺ = Ax̂ + Bu`, with `L = S Cᵀ(CSCᵀ + V_p)⁻¹`.
    Filter,
}

/// What was recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct Recorded {
    /// The covariance, p×p, of the instrument that recorded y apart from the senses; `None` where what was recorded is
    /// what the person sensed, noise included.
    pub instrument: Option<DMatrix<f64>>,
    /// The control, with the covariance, m×m, of what recorded it (zero where it is exact); `None` where it was not
    /// recorded.
    pub control: Option<DMatrix<f64>>,
    /// Whether the recorded control is `u + m`, what reached the plant, instead of the command u.
    pub is_applied: bool,
}

/// What the trials start from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Start {
    /// x = x̂ = 0 exactly.
    Rest,
    /// Anywhere where the loop's own noise takes it: mean zero, and the covariance of the loop's steady state.
    Settled,
}

/// Everything that is known beforehand. Its parameters θ are the logarithms of the coefficients of the terms that are
/// not held, in the order of the terms.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// The plant.
    pub plant: Plant,
    /// The terms of Q, W_p, W, V and M.
    pub terms: Vec<Term>,
    /// R, m×m: the scale of the costs.
    pub control_weight: DMatrix<f64>,
    /// V_p, p×p: the scale of the perceived noises.
    pub perceived_measurement_noise: DMatrix<f64>,
    /// Whether the person knows d.
    pub is_told: bool,
    /// When the belief takes in what is sensed.
    pub timing: Timing,
    /// What was recorded.
    pub recorded: Recorded,
    /// What the trials start from.
    pub start: Start,
}

/// A person: what the parameters come to.
#[derive(Debug, Clone, PartialEq)]
pub struct Member {
    /// K, m×n.
    pub k: DMatrix<f64>,
    /// L, n×p: the gain of the predictor, or of the filter, by [`Timing`].
    pub l: DMatrix<f64>,
    /// Q, n×n.
    pub q: DMatrix<f64>,
    /// W_p, n×n.
    pub perceived: DMatrix<f64>,
    /// W, n×n.
    pub w: DMatrix<f64>,
    /// V, p×p.
    pub v: DMatrix<f64>,
    /// M, m×m.
    pub m: DMatrix<f64>,
    /// Derivatives by θ, where they were asked for.
    pub slopes: Vec<MemberSlope>,
}

/// A derivative of a [`Member`]; `None` where the parameter does not move the matrix.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MemberSlope {
    /// Of K.
    pub k: Option<DMatrix<f64>>,
    /// Of L.
    pub l: Option<DMatrix<f64>>,
    /// Of W.
    pub w: Option<DMatrix<f64>>,
    /// Of V.
    pub v: Option<DMatrix<f64>>,
    /// Of M.
    pub m: Option<DMatrix<f64>>,
}

impl Design {
    /// n, m, p, q: states, controls, outputs, inputs of the experimenter.
    #[must_use]
    pub fn sizes(&self) -> [usize; 4] {
        let Plant { a, b, c, e } = &self.plant;
        [a.nrows(), b.ncols(), c.nrows(), e.ncols()]
    }

    /// The terms that are estimated, in the order of θ.
    pub fn free(&self) -> impl Iterator<Item = &Term> + Clone {
        self.terms.iter().filter(|term| term.held.is_none())
    }

    /// Each term with its coefficient at θ.
    fn coefficients<'a>(&'a self, theta: &'a [f64]) -> impl Iterator<Item = (&'a Term, f64)> + 'a {
        let mut next = theta.iter();
        self.terms
            .iter()
            .map(move |term| (term, term.held.unwrap_or_else(|| next.next().map_or(f64::NAN, |v| v.exp()))))
    }

    /// The matrix of a role at θ; of this order where no term is part of it.
    fn sum(&self, theta: &[f64], role: Role, order: usize) -> DMatrix<f64> {
        self.coefficients(theta)
            .filter(|(term, _)| term.role == role)
            .fold(DMatrix::zeros(order, order), |sum, (term, value)| sum + &term.shape * value)
    }

    /// The person at θ, with derivatives if asked; `None` where no regulator or no filter is stabilising there.
    ///
    /// Of the Riccati equations `dP = A_cᵀ dP A_c + dQ` with `A_c = A − BK` and `dK = (R + BᵀPB)⁻¹Bᵀ dP A_c`; of the
    /// filter's, which is dual, `dS = A_f dS A_fᵀ + dW_p` with `A_f = A − LC` and `dL = A_f dS Cᵀ(CSCᵀ + V_p)⁻¹`.
    ///
    /// # Panics
    /// If θ has another length than there are free terms, which is a mistake of the caller.
    #[must_use]
    pub fn member(&self, theta: &[f64], slopes: bool) -> Option<Member> {
        assert_eq!(theta.len(), self.free().count(), "parameters of an LQG person");
        let [n, m, p, _] = self.sizes();
        let Plant { a, b, c, .. } = &self.plant;
        let q = self.sum(theta, Role::StateWeight, n);
        let perceived = self.sum(theta, Role::PerceivedProcessNoise, n);
        let solve = |a: &DMatrix<f64>, b: &DMatrix<f64>, q: &DMatrix<f64>, r: &DMatrix<f64>| {
            Riccati::new(a, b, q, r, Clock::Sampled).ok()?.solve().ok()
        };
        let regulator = solve(a, b, &q, &self.control_weight)?;
        let filter = solve(&a.transpose(), &c.transpose(), &perceived, &self.perceived_measurement_noise)?;
        let weight = symmetric(&(&self.control_weight + b.tr_mul(&regulator.p) * b));
        let innovation = symmetric(&(&self.perceived_measurement_noise + c * &filter.p * c.transpose()));
        // L of the predictor is A times that of the filter.
        let update = solve_symmetric(&innovation, &(c * &filter.p)).transpose();
        let predictor = filter.k.transpose();
        let l = if self.timing == Timing::Filter { update.clone() } else { predictor.clone() };
        let mut all = Vec::new();
        if slopes {
            let closed = a - b * &regulator.k;
            let error = a - &predictor * c;
            let of_regulator = Lyapunov::new(&closed, Clock::Sampled).ok()?;
            let of_filter = Lyapunov::new(&error, Clock::Sampled).ok()?;
            // A term's derivative by its logarithm is the term itself.
            for (term, value) in self.coefficients(theta).filter(|(term, _)| term.held.is_none()) {
                let moved = &term.shape * value;
                let mut slope = MemberSlope::default();
                match term.role {
                    Role::StateWeight => {
                        let dp = of_regulator.solve(&moved);
                        slope.k = Some(solve_symmetric(&weight, &(b.tr_mul(&dp) * &closed)));
                    }
                    Role::PerceivedProcessNoise => {
                        let ds = of_filter.solve_adjoint(&moved);
                        let left = match self.timing {
                            Timing::Predictor => error.clone(),
                            Timing::Filter => DMatrix::identity(n, n) - &update * c,
                        };
                        slope.l = Some(solve_symmetric(&innovation, &(c * ds * left.transpose())).transpose());
                    }
                    Role::ProcessNoise => slope.w = Some(moved),
                    Role::MeasurementNoise => slope.v = Some(moved),
                    Role::MotorNoise => slope.m = Some(moved),
                }
                all.push(slope);
            }
        }
        Some(Member {
            k: regulator.k,
            l,
            q,
            perceived,
            w: self.sum(theta, Role::ProcessNoise, n),
            v: self.sum(theta, Role::MeasurementNoise, p),
            m: self.sum(theta, Role::MotorNoise, m),
            slopes: all,
        })
    }
}
