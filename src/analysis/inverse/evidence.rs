//! What a verdict rests on, as it is written.

use super::half::Half;
use super::parts::{Rows, Verdict, poles, rows};
use crate::convex::lmi::SolvedBy;
use crate::inverse::lqr::InverseLqr;
use crate::inverse::{Evidence, Role};
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::Serialize;

/// What a verdict rests on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "InverseEvidenceKind")]
pub enum EvidenceKind {
    /// One input: the least of `|1 + K(jω − A)⁻¹B|² − 1` (in sampled time less `R/(R + BᵀPB)`) over its uncertainty.
    ReturnDifference,
    /// One input in sampled time: `R/(R + BᵀPB) = det(A − BK)/det A`, which must be positive.
    InputWeight,
    /// Several inputs: weights whose margin exceeds the rounding.
    Weights,
    /// Several inputs: a multiplier that contradicts all weights.
    Multiplier,
    /// Several inputs: an antisymmetric matrix that contradicts every R.
    Coupling,
    /// Sampled time with a singular A: the gain on the kernel of A, which must vanish.
    Kernel,
    /// No certificate was found on either side.
    None,
}

/// What a verdict rests on, and how far it is from another one; without a structure, on the states that inputs reach.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InverseEvidence")]
pub struct EvidenceResult {
    /// Which sort of certificate.
    pub kind: EvidenceKind,
    /// The verdict that it proves, whatever the structure.
    pub verdict: Verdict,
    /// Its margin over what the rounding of the data moves, dimensionless: above 1 on the feasible side, below −1 on
    /// the infeasible one, and between them the boundary. Null without a certificate.
    pub ratio: Option<f64>,
    /// The frequency that decides, in rad/s; null where that is a limit (infinity in continuous time), or none is.
    pub omega_rad_s: Option<f64>,
    /// The number that decides, dimensionless; where the limit at infinity decides that of ω²F, in 1/s². Null where a
    /// matrix decides.
    pub value: Option<f64>,
    /// How far the rounding of the data moves that number, in its unit.
    pub rounding: Option<f64>,
    /// N of the multiplier, in the shape of the gain and in the units of inputs times states: with X of
    /// `A_cX + XA_cᵀ = BN + NᵀBᵀ` (in sampled time `X = A_cXA_cᵀ − BNA_cᵀ − A_cNᵀBᵀ`), `A_c = A − BK`, X is definite
    /// and `⟨X, Q⟩ = −⟨R, KXKᵀ + NKᵀ + KNᵀ⟩ < 0` for all weights. Null for other evidence.
    pub multiplier: Option<Rows>,
    /// Ω of a coupling, antisymmetric, in products of the units of two inputs: with `M = KB` (in sampled time
    /// `K(A − BK)⁻¹B`) `ΩMᵀ − MΩ` is definite but for a share of 1e-6, and orthogonal to every R for which R·M is
    /// symmetric, as it must be. Null for other evidence.
    pub coupling: Option<Rows>,
    /// The frequencies that N is made of, in rad/s; null likewise. Infinity is left out.
    pub frequencies_rad_s: Option<Vec<f64>>,
    /// P and R that prove a feasible verdict of several inputs, n×n in units of cost over those of the states (in
    /// continuous time times s); the answer's own weights are better conditioned. Null for other evidence.
    pub p: Option<Rows>,
    /// R beside that P, in units of cost over those of the inputs.
    pub r: Option<Rows>,
    /// The largest error of each entry of the gain within which the verdict is made, in the shape and units of the
    /// gain; null where inputs do not reach every state.
    pub gain_rounding: Option<Rows>,
}

/// What proves that a structure has no weights, where without one there may be some.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InverseRefutation")]
pub struct RefutationResult {
    /// N, in the shape of the gain and in the units of inputs times states, as in `evidence`: the entries of X that the
    /// structure lets Q have complete to a definite matrix, and `⟨X, Q⟩ = −⟨R, KXKᵀ + NKᵀ + KNᵀ⟩ < 0` for all its
    /// weights.
    pub multiplier: Rows,
    /// Its margin over what the rounding of the data moves, dimensionless; above 1.
    pub ratio: f64,
}

/// Modes that no input reaches (no output sees).
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InverseUnreached")]
pub struct UnreachedResult {
    /// Those that decay by themselves, as `[re, im]`, in rad/s (in sampled time in z, dimensionless). The gain on them
    /// is free: a large weight makes any of them optimal.
    pub decaying: Vec<[f64; 2]>,
    /// Those that do not, such as targets, likewise. The cost weighs the distances from their set points.
    pub lasting: Vec<[f64; 2]>,
    /// One column for each of the lasting modes: the states that the loop holds against it, n rows, in the units of
    /// the states; null without lasting modes.
    pub set_points: Option<Rows>,
}

/// Who solved the matrix inequality of the least condition number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "InverseSolvedBy")]
pub enum SolvedByName {
    /// clarabel.
    Clarabel,
    /// The built-in method.
    InteriorPoint,
    /// Both: clarabel's answer failed its check, and the built-in method's stands.
    Both,
}

impl From<SolvedBy> for SolvedByName {
    fn from(by: SolvedBy) -> Self {
        match by {
            SolvedBy::Clarabel => Self::Clarabel,
            SolvedBy::InteriorPoint => Self::InteriorPoint,
            SolvedBy::Both => Self::Both,
        }
    }
}

/// A matrix in the shape of the gain as it is written: a filter's is transposed here.
fn like_the_gain(half: &Half, m: &DMatrix<f64>) -> Rows {
    if half.gains.role() == Role::Filter { rows(&m.transpose()) } else { rows(m) }
}

pub(super) fn evidence(half: &Half, answer: &InverseLqr) -> EvidenceResult {
    let found = &answer.decision;
    let per_second = half.sample_time_s.map_or(1.0, |period| 1.0 / period);
    let mut result = EvidenceResult {
        kind: EvidenceKind::None,
        verdict: found.verdict.into(),
        ratio: found.ratio.filter(|v| v.is_finite()),
        omega_rad_s: None,
        value: None,
        rounding: None,
        multiplier: None,
        coupling: None,
        frequencies_rad_s: None,
        p: None,
        r: None,
        gain_rounding: half.gains.rounding().map(|m| like_the_gain(half, &m)),
    };
    let finite = |v: f64| Some(v).filter(|v| v.is_finite());
    match &found.evidence {
        Evidence::ReturnDifference { omega, value, rounding } => {
            result.kind = EvidenceKind::ReturnDifference;
            result.omega_rad_s = finite(omega * per_second);
            (result.value, result.rounding) = (finite(*value), finite(*rounding));
        }
        Evidence::InputWeight { value, rounding } => {
            result.kind = EvidenceKind::InputWeight;
            (result.value, result.rounding) = (finite(*value), finite(*rounding));
        }
        Evidence::Kernel { value, rounding } => {
            result.kind = EvidenceKind::Kernel;
            (result.value, result.rounding) = (finite(*value), finite(*rounding));
        }
        Evidence::Weights { p, r } => {
            result.kind = EvidenceKind::Weights;
            result.p = p.as_ref().map(rows);
            result.r = Some(rows(r));
        }
        Evidence::Multiplier { n, frequencies } => {
            result.kind = EvidenceKind::Multiplier;
            result.multiplier = n.as_ref().map(|n| like_the_gain(half, n));
            let all = frequencies.iter().map(|omega| omega * per_second).filter(|v| v.is_finite());
            result.frequencies_rad_s = Some(all.collect());
        }
        Evidence::Coupling { omega } => {
            result.kind = EvidenceKind::Coupling;
            result.coupling = Some(rows(omega));
        }
        Evidence::None => {}
    }
    result
}

/// Null where the structure has weights, or the whole has none.
pub(super) fn refutation(half: &Half, answer: &InverseLqr) -> Option<RefutationResult> {
    let found = answer.refutation.as_ref()?;
    Some(RefutationResult { multiplier: like_the_gain(half, &found.n), ratio: found.ratio })
}

/// Null where inputs reach every state.
pub(super) fn unreached(half: &Half) -> Option<UnreachedResult> {
    let targets = half.gains.targets();
    if targets.is_none() && half.gains.decaying().is_empty() {
        return None;
    }
    Some(UnreachedResult {
        decaying: poles(half.gains.decaying()),
        lasting: targets.map_or_else(Vec::new, |targets| poles(&targets.modes)),
        set_points: targets.map(|targets| rows(&targets.set_points)),
    })
}
