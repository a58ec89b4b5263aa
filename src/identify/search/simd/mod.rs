//! What the kernels share: lanes in single or double precision, packed LDLᵀ, dispatch by the sizes of the half-bases.

pub(crate) mod dispatch;
pub(crate) mod lanes;
pub(crate) mod ldl;
