//! Where compensators are looked for.

/// Between which values the unknowns of a section are looked for; equal ends fix one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SectionBox {
    /// Of first order.
    First {
        /// f_z, Hz.
        zero_hz: [f64; 2],
        /// f_p, Hz.
        pole_hz: [f64; 2],
    },
    /// Of second order.
    Second {
        /// f_z, Hz.
        zero_hz: [f64; 2],
        /// f_p, Hz.
        pole_hz: [f64; 2],
        /// ζ_z and ζ_p.
        damping: [f64; 2],
    },
}

/// Between which values each unknown is looked for; equal ends fix it.
#[derive(Debug, Clone, PartialEq)]
pub struct SearchBox {
    /// K.
    pub gain: [f64; 2],
    /// The sections; none for proportional control.
    pub sections: Vec<SectionBox>,
    /// Whether f_z ≤ f_p is asked for of sections of first order: leads in the strict sense.
    pub zero_below_pole: bool,
}
