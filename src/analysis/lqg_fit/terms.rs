//! The terms of a spec: coefficients and the matrices that they multiply.

use super::signals::{Sampled, sized};
use super::spec::{LqgFitScale, LqgFitSpec, LqgFitTerm};
use crate::analysis::problem::Problem;
use crate::analysis::reading::wrong_spec as wrong;
use crate::likelihood::lqg::{Role, Term};
use crate::num::linalg::symmetric;
use nalgebra::{DMatrix, DVector};

/// Parameters of a fit at most.
const MAX_PARAMETERS: usize = 30;
/// A matrix differs from its transpose by less than this share of its norm.
const SYMMETRY: f64 = 1e-10;
/// A negative eigenvalue below this share of the largest is rounding.
const SEMIDEFINITE: f64 = 1e-12;

/// A term, with where it is written and whose coefficient it has.
struct Written {
    term: Term,
    at: String,
    same_as: Option<String>,
}

/// All terms of a spec.
pub(super) struct Terms {
    pub terms: Vec<Term>,
    /// What R and V_p have beside their terms.
    pub control_weight: DMatrix<f64>,
    pub perceived_measurement_noise: DMatrix<f64>,
}

fn spec_wrong(detail: String, at: String) -> Problem {
    wrong(detail, at)
}

/// A covariance or weight of the spec: symmetric and positive semidefinite.
pub(super) fn semidefinite(rows: &[Vec<f64>], letter: &str, order: usize, at: &str) -> Result<DMatrix<f64>, Problem> {
    let found = sized(rows, letter, (order, order), at, spec_wrong)?;
    if (&found - found.transpose()).norm() > SYMMETRY * found.norm() {
        return Err(wrong(format!("{letter} is not symmetric"), at));
    }
    let found = symmetric(&found);
    let values = found.symmetric_eigenvalues();
    if values.min() < -SEMIDEFINITE * values.amax() {
        let detail = format!("{letter} is not positive semidefinite: its least eigenvalue is {:e}", values.min());
        return Err(wrong(detail, at));
    }
    Ok(found)
}

/// The same, positive definite; the identity where nothing is written.
pub(super) fn definite(
    rows: Option<&Vec<Vec<f64>>>,
    letter: &str,
    order: usize,
    at: &str,
) -> Result<DMatrix<f64>, Problem> {
    let Some(rows) = rows else { return Ok(DMatrix::identity(order, order)) };
    let found = semidefinite(rows, letter, order, at)?;
    if found.clone().cholesky().is_none() {
        return Err(wrong(format!("{letter} is not positive definite"), at));
    }
    Ok(found)
}

/// The terms of a matrix of the spec.
fn terms(written: &[LqgFitTerm], role: Role, order: usize, at: &str) -> Result<Vec<Written>, Problem> {
    let one = |(i, term): (usize, &LqgFitTerm)| {
        let place = |name: &str| format!("{at}/{i}/{name}");
        if term.name.is_empty() {
            return Err(wrong("the name is empty", place("name")));
        }
        let name = &term.name;
        let (shape, where_) = match (&term.diagonal, &term.matrix) {
            (Some(diagonal), None) => {
                if diagonal.len() != order {
                    let detail = format!("the diagonal of {name} has {} entries and must have {order}", diagonal.len());
                    return Err(wrong(detail, place("diagonal")));
                }
                if let Some(value) = diagonal.iter().find(|v| !(**v >= 0.0 && v.is_finite())) {
                    let detail = format!("the diagonal of {name} has the entry {value}, and must not be negative");
                    return Err(wrong(detail, place("diagonal")));
                }
                (DMatrix::from_diagonal(&DVector::from_column_slice(diagonal)), "diagonal")
            }
            (None, Some(rows)) => {
                (semidefinite(rows, &format!("the matrix of {name}"), order, &place("matrix"))?, "matrix")
            }
            (Some(_), Some(_)) => return Err(wrong(format!("{name} has a diagonal and a matrix"), place("matrix"))),
            (None, None) => {
                return Err(wrong(format!("{name} has neither a diagonal nor a matrix"), format!("{at}/{i}")));
            }
        };
        if shape.amax() == 0.0 {
            return Err(wrong(format!("the matrix of {name} is zero"), place(where_)));
        }
        let finite = |value: f64| value.is_finite() && value <= 1e100;
        if let Some(held) = term.held.filter(|v| !(*v >= 0.0 && finite(*v))) {
            return Err(wrong(format!("{name} is held at {held}, and must not be negative"), place("held")));
        }
        if let Some(start) = term.start.filter(|v| !(*v > 0.0 && finite(*v))) {
            return Err(wrong(format!("{name} starts at {start}, and must be positive"), place("start")));
        }
        if term.held.is_some() && term.start.is_some() {
            return Err(wrong(format!("{name} is held and started"), place("start")));
        }
        if term.same_as.is_some() && (term.held.is_some() || term.start.is_some()) {
            let detail = format!("{name} has the coefficient of another term, and one of its own");
            return Err(wrong(detail, place("same_as")));
        }
        let found = Term { name: name.clone(), role, shape, held: term.held, start: term.start, same_as: None };
        Ok(Written { term: found, at: format!("{at}/{i}"), same_as: term.same_as.clone() })
    };
    written.iter().enumerate().map(one).collect()
}

/// A term for every entry of the diagonal.
fn one_each(prefix: &str, role: Role, order: usize) -> Vec<Term> {
    let one = |i: usize| Term {
        name: format!("{prefix}{}", i + 1),
        role,
        shape: DMatrix::from_fn(order, order, |row, column| if row == i && column == i { 1.0 } else { 0.0 }),
        held: None,
        start: None,
        same_as: None,
    };
    (0..order).map(one).collect()
}

/// Costs of one kind and noises of the other: coefficients of both have other units.
fn is_cost(role: Role) -> bool {
    matches!(role, Role::StateWeight | Role::TerminalWeight | Role::ControlWeight)
}

/// A weight or covariance that is known, or has terms.
fn scale(
    written: Option<&LqgFitScale>,
    letter: &str,
    role: Role,
    order: usize,
    at: &str,
) -> Result<(DMatrix<f64>, Vec<Written>), Problem> {
    match written {
        None => Ok((DMatrix::identity(order, order), Vec::new())),
        Some(LqgFitScale::Known(rows)) => Ok((definite(Some(rows), letter, order, at)?, Vec::new())),
        Some(LqgFitScale::Terms(list)) => {
            let found = terms(list, role, order, at)?;
            let sum = found
                .iter()
                .filter(|w| w.term.held != Some(0.0))
                .fold(DMatrix::zeros(order, order), |sum, w| sum + &w.term.shape);
            if sum.cholesky().is_none() {
                return Err(wrong(format!("{letter} is not positive definite, whatever the coefficients"), at));
            }
            Ok((DMatrix::zeros(order, order), found))
        }
    }
}

impl Terms {
    /// The terms of a spec, for a true plant of `n` states and a person's model of it.
    ///
    /// # Errors
    /// A [`Problem`] with the pointer of the term that is wrong, or of a scale that nothing holds.
    pub(super) fn new(spec: &LqgFitSpec, sampled: &Sampled, internal: &Sampled) -> Result<Self, Problem> {
        let (n, m, p) = (sampled.plant.a.nrows(), sampled.plant.b.ncols(), sampled.plant.c.nrows());
        let own = internal.plant.a.nrows();
        let borne = |name: &str, role, of: &Sampled| {
            let shape = of.control_borne.clone();
            vec![Term { name: name.to_owned(), role, shape, held: None, start: None, same_as: None }]
        };
        let (control_weight, of_r) =
            scale(spec.control_weight.as_ref(), "R", Role::ControlWeight, m, "/spec/control_weight")?;
        let (perceived_measurement_noise, of_v) = scale(
            spec.perceived_measurement_noise.as_ref(),
            "V_p",
            Role::PerceivedMeasurementNoise,
            p,
            "/spec/perceived_measurement_noise",
        )?;
        let perceived = borne("wp", Role::PerceivedProcessNoise, internal);
        let mut all: Vec<Written> = Vec::new();
        let parts = [
            ("state_weight", &spec.state_weight, Role::StateWeight, own, one_each("q", Role::StateWeight, own)),
            ("perceived_process_noise", &spec.perceived_process_noise, Role::PerceivedProcessNoise, own, perceived),
            ("process_noise", &spec.process_noise, Role::ProcessNoise, n, borne("w", Role::ProcessNoise, sampled)),
            (
                "measurement_noise",
                &spec.measurement_noise,
                Role::MeasurementNoise,
                p,
                one_each("v", Role::MeasurementNoise, p),
            ),
            ("motor_noise", &spec.motor_noise, Role::MotorNoise, m, Vec::new()),
        ];
        for (name, written, role, order, usual) in parts {
            let at = format!("/spec/{name}");
            match written {
                Some(written) => all.extend(terms(written, role, order, &at)?),
                None => all.extend(usual.into_iter().enumerate().map(|(i, term)| Written {
                    term,
                    at: format!("{at}/{i}"),
                    same_as: None,
                })),
            }
        }
        all.extend(of_r);
        all.extend(of_v);
        if let Some(horizon) = &spec.horizon {
            match &horizon.terminal_weight {
                Some(written) => {
                    all.extend(terms(written, Role::TerminalWeight, own, "/spec/horizon/terminal_weight")?);
                }
                None => {
                    let of_q = all.iter().filter(|w| w.term.role == Role::StateWeight);
                    let usual: Vec<Written> = of_q
                        .map(|w| Written {
                            term: Term {
                                name: format!("{} at the end", w.term.name),
                                role: Role::TerminalWeight,
                                shape: w.term.shape.clone(),
                                held: None,
                                start: None,
                                same_as: None,
                            },
                            at: "/spec/horizon".to_owned(),
                            same_as: Some(w.same_as.clone().unwrap_or_else(|| w.term.name.clone())),
                        })
                        .collect();
                    all.extend(usual);
                }
            }
            if let Some(written) = &horizon.initial_covariance {
                all.extend(terms(written, Role::InitialCovariance, own, "/spec/horizon/initial_covariance")?);
            }
        }
        if let Some(noise) = &spec.control_dependent_noise {
            let list = [LqgFitTerm {
                name: noise.name.clone(),
                diagonal: Some(vec![1.0; m]),
                matrix: None,
                held: noise.held,
                start: noise.start,
                same_as: None,
            }];
            all.extend(
                terms(&list, Role::ControlDependentNoise, m, "/spec/control_dependent_noise")
                    .map_err(|problem| wrong(problem.detail, "/spec/control_dependent_noise"))?,
            );
        }
        let found = Self { terms: tied(all)?, control_weight, perceived_measurement_noise };
        found.check()?;
        Ok(found)
    }

    /// Checks that costs and beliefs have terms, and scales.
    fn check(&self) -> Result<(), Problem> {
        let root = |term: &'_ Term| term.same_as.map_or(term.clone(), |at| self.terms[at].clone());
        let is_there = |term: &Term| root(term).held != Some(0.0);
        let has = |roles: &[Role]| self.terms.iter().any(|term| roles.contains(&term.role) && is_there(term));
        for (roles, name) in [
            (&[Role::StateWeight, Role::TerminalWeight][..], "state_weight"),
            (&[Role::PerceivedProcessNoise, Role::InitialCovariance][..], "perceived_process_noise"),
        ] {
            if !has(roles) {
                return Err(wrong(format!("{name} has no term"), format!("/spec/{name}")));
            }
        }
        let is_held = |roles: &[Role]| {
            self.terms.iter().any(|term| {
                let root = root(term);
                roles.contains(&term.role) && (root.held.is_some_and(|v| v > 0.0) || !roles.contains(&root.role))
            })
        };
        let costs = [Role::StateWeight, Role::TerminalWeight, Role::ControlWeight];
        if self.control_weight.amax() == 0.0 && !is_held(&costs) {
            return Err(wrong("costs are only known up to one factor, and no weight is held", "/spec/control_weight")
                .mend("Hold one term of the weights, as the scale of the cost."));
        }
        let beliefs = [Role::PerceivedProcessNoise, Role::PerceivedMeasurementNoise, Role::InitialCovariance];
        if self.perceived_measurement_noise.amax() == 0.0 && !is_held(&beliefs) {
            return Err(wrong(
                "perceived noises are only known up to one factor, and none of them is held or a true one",
                "/spec/perceived_measurement_noise",
            )
            .mend("Hold one term of them, or let one be the same_as a true noise."));
        }
        let free = self.terms.iter().filter(|term| term.held.is_none() && term.same_as.is_none()).count();
        if free == 0 || free > MAX_PARAMETERS {
            let detail = format!("there are {free} parameters; 1 to {MAX_PARAMETERS} are fitted");
            return Err(wrong(detail, "/spec/state_weight"));
        }
        Ok(())
    }
}

/// The terms, each with the place of the one whose coefficient it has.
fn tied(all: Vec<Written>) -> Result<Vec<Term>, Problem> {
    for (i, written) in all.iter().enumerate() {
        let name = &written.term.name;
        if all[..i].iter().any(|other| other.term.name == *name) {
            return Err(wrong(format!("the name {name:?} is taken already"), format!("{}/name", written.at)).mend(
                "Every parameter needs a name of its own: q1, q2, wp, w, v1 where nothing is written. Two terms of one \
                 coefficient are written with same_as.",
            ));
        }
    }
    let place = |written: &Written| -> Result<Option<usize>, Problem> {
        let Some(other) = &written.same_as else { return Ok(None) };
        let at = format!("{}/same_as", written.at);
        let name = &written.term.name;
        let Some(place) = all.iter().position(|w| w.term.name == *other) else {
            return Err(wrong(format!("there is no term {other:?} that {name} could have the coefficient of"), at));
        };
        let root = &all[place];
        if root.same_as.is_some() {
            return Err(wrong(format!("{other} itself has the coefficient of another term"), at));
        }
        let grows = |role: Role| role == Role::ControlDependentNoise;
        if is_cost(root.term.role) != is_cost(written.term.role) || grows(root.term.role) {
            return Err(wrong(
                format!("{name} and {other} are not of one kind: costs with costs, noises with noises"),
                at,
            ));
        }
        Ok(Some(place))
    };
    let places: Vec<Option<usize>> = all.iter().map(place).collect::<Result<_, _>>()?;
    Ok(all.into_iter().zip(places).map(|(written, same_as)| Term { same_as, ..written.term }).collect())
}
