//! The parameters of seated balance by name.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A parameter of seated balance. Those that Table 5.1 of Priess 2015 fits come first, in its order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
pub enum Parameter {
    /// K₁, N m/rad: torque for α₁.
    #[serde(rename = "k1")]
    LowerAngleGain,
    /// K₂, N m s/rad: torque for α̇₁.
    #[serde(rename = "k2")]
    LowerRateGain,
    /// K₃, N m/rad: torque for α₂.
    #[serde(rename = "k3")]
    UpperAngleGain,
    /// K₄, N m s/rad: torque for α̇₂.
    #[serde(rename = "k4")]
    UpperRateGain,
    /// J₁, kg m²: lower body and seat about their centre of mass.
    #[serde(rename = "j1")]
    LowerInertia,
    /// J₂, kg m²: upper body about its centre of mass.
    #[serde(rename = "j2")]
    UpperInertia,
    /// l₁, m: from the pivot to the centre of mass of the lower body.
    #[serde(rename = "l1")]
    LowerCentre,
    /// l₁₂, m: from the pivot to the fourth lumbar vertebra.
    #[serde(rename = "l12")]
    LumbarHeight,
    /// l₂, m: from the vertebra to the centre of mass of the upper body.
    #[serde(rename = "l2")]
    UpperCentre,
    /// τ, s: the delay of the senses.
    #[serde(rename = "tau")]
    Delay,
    /// T_w, s: the time constant of the muscle.
    #[serde(rename = "t_w")]
    MuscleLag,
    /// M₁, kg: lower body and seat.
    #[serde(rename = "m1")]
    LowerMass,
    /// M₂, kg: upper body.
    #[serde(rename = "m2")]
    UpperMass,
    /// k_r, N m/rad: the virtual spring of the seat; the tissue's stiffness k_b where an angle drives it.
    #[serde(rename = "k_r", alias = "k_b")]
    SeatStiffness,
    /// c_r, N m s/rad: the virtual damper of the seat; the tissue's damping c_b where an angle drives it.
    #[serde(rename = "c_r", alias = "c_b")]
    SeatDamping,
    /// k_h, N m/rad: the stiffness of the back.
    #[serde(rename = "k_h")]
    BackStiffness,
    /// c_h, N m s/rad: the damping of the back.
    #[serde(rename = "c_h")]
    BackDamping,
    /// g, m/s².
    #[serde(rename = "g")]
    Gravity,
}

impl Parameter {
    /// How many there are.
    pub const COUNT: usize = 18;

    /// All of them; the first eleven are the θ of §5.2.
    pub const ALL: [Self; Self::COUNT] = [
        Self::LowerAngleGain,
        Self::LowerRateGain,
        Self::UpperAngleGain,
        Self::UpperRateGain,
        Self::LowerInertia,
        Self::UpperInertia,
        Self::LowerCentre,
        Self::LumbarHeight,
        Self::UpperCentre,
        Self::Delay,
        Self::MuscleLag,
        Self::LowerMass,
        Self::UpperMass,
        Self::SeatStiffness,
        Self::SeatDamping,
        Self::BackStiffness,
        Self::BackDamping,
        Self::Gravity,
    ];

    /// K₁ to K₄.
    pub const GAINS: [Self; 4] = [Self::LowerAngleGain, Self::LowerRateGain, Self::UpperAngleGain, Self::UpperRateGain];

    /// The name in JSON: the symbol of the thesis.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::LowerAngleGain => "k1",
            Self::LowerRateGain => "k2",
            Self::UpperAngleGain => "k3",
            Self::UpperRateGain => "k4",
            Self::LowerInertia => "j1",
            Self::UpperInertia => "j2",
            Self::LowerCentre => "l1",
            Self::LumbarHeight => "l12",
            Self::UpperCentre => "l2",
            Self::Delay => "tau",
            Self::MuscleLag => "t_w",
            Self::LowerMass => "m1",
            Self::UpperMass => "m2",
            Self::SeatStiffness => "k_r",
            Self::SeatDamping => "c_r",
            Self::BackStiffness => "k_h",
            Self::BackDamping => "c_h",
            Self::Gravity => "g",
        }
    }

    /// The parameter with this name; `k_b` and `c_b`, as chapter 3 calls them, are `k_r` and `c_r`.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        let name = match name {
            "k_b" => "k_r",
            "c_b" => "c_r",
            other => other,
        };
        Self::ALL.into_iter().find(|p| p.name() == name)
    }

    /// Its unit.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Self::LowerAngleGain | Self::UpperAngleGain | Self::SeatStiffness | Self::BackStiffness => "N m/rad",
            Self::LowerRateGain | Self::UpperRateGain | Self::SeatDamping | Self::BackDamping => "N m s/rad",
            Self::LowerInertia | Self::UpperInertia => "kg m^2",
            Self::LowerCentre | Self::LumbarHeight | Self::UpperCentre => "m",
            Self::Delay | Self::MuscleLag => "s",
            Self::LowerMass | Self::UpperMass => "kg",
            Self::Gravity => "m/s^2",
        }
    }

    /// Its value in Table 5.1.
    #[must_use]
    pub fn nominal(self) -> f64 {
        match self {
            Self::LowerAngleGain => 143.55,
            Self::LowerRateGain => 105.86,
            Self::UpperAngleGain => 677.98,
            Self::UpperRateGain => 242.17,
            Self::LowerInertia => 2.026,
            Self::UpperInertia => 2.988,
            Self::LowerCentre => 0.0022,
            Self::LumbarHeight => 0.245,
            Self::UpperCentre => 0.395,
            Self::Delay => 0.0252,
            Self::MuscleLag => 0.0989,
            Self::LowerMass => 55.0,
            Self::UpperMass => 39.5,
            Self::SeatStiffness => 100.0,
            Self::SeatDamping => 2.0,
            Self::BackStiffness => 13.15,
            Self::BackDamping => 4.72,
            Self::Gravity => 9.81,
        }
    }

    /// The values for which the model is defined: inertias, masses, delay and lag are positive, the rest is finite.
    #[must_use]
    pub fn limits(self) -> [f64; 2] {
        const LARGE: f64 = 1e12;
        match self {
            Self::LowerInertia | Self::UpperInertia | Self::LowerMass | Self::UpperMass => [1e-9, LARGE],
            // Shorter than this the approximation of the delay is stiffer than working precision resolves.
            Self::Delay | Self::MuscleLag => [1e-6, 1e3],
            _ => [-LARGE, LARGE],
        }
    }
}
