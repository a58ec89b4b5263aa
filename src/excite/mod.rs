//! Excitation: the perturbations of an experiment, how good they are, and how they are made better.
//!
//! [`sequence`] makes them, [`spectrum`] and [`flatness`] judge them (Qiu 2021, equations 1–16), [`compensator`] shapes the
//! position loop that carries them to the person, and [`motion`] says what they ask of a device and of a body.

pub mod design;
pub mod robust;
pub mod sequence;
