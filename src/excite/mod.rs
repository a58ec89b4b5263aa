//! Excitation: the perturbations of an experiment, how good they are, and the loop that carries them to the person.
//!
//! [`sequence`] makes them, [`spectrum`] and [`flatness`] judge them (Qiu 2021, equations 1–16), [`path`] carries them
//! through a plant or a position loop, [`compensator`] shapes that loop, and [`motion`] says what they ask of a device
//! and of a body.

pub mod compensator;
pub mod design;
pub mod flatness;
pub mod measured;
pub mod motion;
pub mod path;
pub mod peak;
pub mod recording;
pub mod robust;
pub mod sequence;
pub mod spectrum;
