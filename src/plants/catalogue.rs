//! Plants of published tracking studies, by name.

use crate::control::{Continuous, TransferFunction};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// A plant of the catalogue.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "CataloguePlant")]
pub enum Plant {
    /// [`two_mass`].
    TwoMass,
    /// [`minimum_phase`].
    MinimumPhase,
    /// [`nonminimum_phase`].
    NonminimumPhase,
    /// [`slow_nonminimum_phase`].
    SlowNonminimumPhase,
    /// [`integrator`].
    Integrator,
    /// [`damped_double_integrator`].
    DampedDoubleIntegrator,
}

/// A plant whose matrices depend on named parameters, together with the person who controls it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ParametricPlant {
    /// [`SeatedBalance`](super::SeatedBalance).
    SeatedBalance,
}

impl ParametricPlant {
    /// All of them.
    pub const ALL: [Self; 1] = [Self::SeatedBalance];

    /// Its name, as in JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::SeatedBalance => "seated_balance",
        }
    }

    /// The plant with this name.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|plant| plant.name() == name)
    }
}

/// A name that no plant of the catalogue has.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no plant {name:?} in the catalogue; it holds {}", names().join(", "))]
pub struct UnknownPlant {
    /// The name asked for.
    pub name: String,
}

fn names() -> Vec<&'static str> {
    Plant::ALL.iter().map(|plant| plant.name()).collect()
}

impl Plant {
    /// The whole catalogue.
    pub const ALL: [Self; 6] = [
        Self::TwoMass,
        Self::MinimumPhase,
        Self::NonminimumPhase,
        Self::SlowNonminimumPhase,
        Self::Integrator,
        Self::DampedDoubleIntegrator,
    ];

    /// Its name, as in JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::TwoMass => "two_mass",
            Self::MinimumPhase => "minimum_phase",
            Self::NonminimumPhase => "nonminimum_phase",
            Self::SlowNonminimumPhase => "slow_nonminimum_phase",
            Self::Integrator => "integrator",
            Self::DampedDoubleIntegrator => "damped_double_integrator",
        }
    }

    /// The plant with this name.
    ///
    /// # Errors
    /// [`UnknownPlant`], which lists the names that exist.
    pub fn by_name(name: &str) -> Result<Self, UnknownPlant> {
        Self::ALL.into_iter().find(|plant| plant.name() == name).ok_or_else(|| UnknownPlant { name: name.into() })
    }

    /// Its transfer function from control to output.
    #[must_use]
    pub fn transfer_function(self) -> TransferFunction<Continuous> {
        match self {
            Self::TwoMass => two_mass(),
            Self::MinimumPhase => minimum_phase(),
            Self::NonminimumPhase => nonminimum_phase(),
            Self::SlowNonminimumPhase => slow_nonminimum_phase(),
            Self::Integrator => integrator(),
            Self::DampedDoubleIntegrator => damped_double_integrator(),
        }
    }
}

/// A constant of the catalogue; its tests build every one of them.
fn plant(num: &[f64], den: &[f64]) -> TransferFunction<Continuous> {
    #[allow(clippy::expect_used)]
    TransferFunction::new(num, den, Continuous).expect("the catalogue holds transfer functions")
}

/// Two masses in a chain between springs and dampers; the force acts on the second mass, whose position is the output
/// (Zhang 2015, equations 3.1–3.3 and the expression for G after them):
///
/// `G(s) = (m₁s² + (c₁+c₂)s + k₁+k₂) / ((m₁s² + c₁s + k₁)(m₂s² + c₂s + k₂) + m₂c₂s³ + m₂k₂s²)`
///
/// with m₁ = 1, m₂ = 0.5, c₁ = 0.56π, c₂ = 0.5π, k₁ = 0.16π², k₂ = 0.5π². Stable and minimum phase.
#[must_use]
pub fn two_mass() -> TransferFunction<Continuous> {
    let (m1, m2) = (1.0, 0.5);
    let (c1, c2) = (0.56 * PI, 0.5 * PI);
    let (k1, k2) = (0.16 * PI * PI, 0.5 * PI * PI);
    plant(
        &[m1, c1 + c2, k1 + k2],
        &[m1 * m2, m1 * c2 + m2 * c1 + m2 * c2, m1 * k2 + m2 * k1 + m2 * k2 + c1 * c2, c1 * k2 + c2 * k1, k1 * k2],
    )
}

/// Mass, spring and damper with a minimum-phase zero at −2.2: `G(s) = 2 (s + 2.2)/(s² + 3.6 s + 4)` (Zhang 2015,
/// equation 5.4).
#[must_use]
pub fn minimum_phase() -> TransferFunction<Continuous> {
    plant(&[2.0, 4.4], &[1.0, 3.6, 4.0])
}

/// The same poles with a nonminimum-phase zero at +2.2: `G(s) = −2 (s − 2.2)/(s² + 3.6 s + 4)` (Zhang 2015, equation
/// 5.5).
#[must_use]
pub fn nonminimum_phase() -> TransferFunction<Continuous> {
    plant(&[-2.0, 4.4], &[1.0, 3.6, 4.0])
}

/// The same poles with a slow nonminimum-phase zero at +0.8: `G(s) = −5.5 (s − 0.8)/(s² + 3.6 s + 4)` (Zhang 2015,
/// equation 5.6).
#[must_use]
pub fn slow_nonminimum_phase() -> TransferFunction<Continuous> {
    plant(&[-5.5, 4.4], &[1.0, 3.6, 4.0])
}

/// `G(s) = 1/s`: the control sets the velocity of the output (the first-order plant of the tracking literature since
/// McRuer).
#[must_use]
pub fn integrator() -> TransferFunction<Continuous> {
    plant(&[1.0], &[1.0, 0.0])
}

/// `G(s) = 1/(s (s + 1))`: the control sets a force on a unit mass with unit damping.
#[must_use]
pub fn damped_double_integrator() -> TransferFunction<Continuous> {
    plant(&[1.0], &[1.0, 1.0, 0.0])
}
