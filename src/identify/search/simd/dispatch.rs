//! Which instructions a kernel is compiled for, and which sizes of the half-bases.

/// The sizes of the half-bases of a feedforward numerator, its real and its imaginary part: known to the compiler,
/// which then unrolls the loops over them, or (not `KNOWN`) the largest that there is room for.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Halves<const P: usize, const Q: usize, const KNOWN: bool>;

impl<const P: usize, const Q: usize, const KNOWN: bool> Halves<P, Q, KNOWN> {
    /// The sizes, where these are the ones that the kernel was dispatched by.
    #[inline(always)]
    pub(crate) fn sizes(self, [even, odd]: [usize; 2]) -> (usize, usize) {
        if KNOWN { (P, Q) } else { (even, odd) }
    }
}

/// Runs a kernel, a `WithSimd` that holds some [`Halves`], with the widest instructions of the processor, and compiled
/// for its sizes where they are listed:
///
/// `dispatch_halves!(sizes, in [1 0, 1 1] else 8, |halves| Kernel { halves, .. })`
macro_rules! dispatch_halves {
    ($sizes:expr, in [$($p:literal $q:literal),+] else $largest:expr, |$halves:ident| $kernel:expr) => {{
        use $crate::identify::search::simd::dispatch::Halves;
        let arch = pulp::Arch::new();
        match $sizes {
            $([$p, $q] => {
                let $halves = Halves::<$p, $q, true>;
                arch.dispatch($kernel)
            })+
            _ => {
                let $halves = Halves::<{ $largest }, { $largest }, false>;
                arch.dispatch($kernel)
            }
        }
    }};
}

pub(crate) use dispatch_halves;
