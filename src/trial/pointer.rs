//! JSON pointers (RFC 6901): where in a document something is.

/// The pointer of the member `name` of what is at `at`.
#[must_use]
pub fn member(at: &str, name: &str) -> String {
    format!("{at}/{}", name.replace('~', "~0").replace('/', "~1"))
}

/// The pointer of a place below `at`, as the deserialiser followed it.
#[must_use]
pub fn below(at: &str, path: &serde_path_to_error::Path) -> String {
    use serde_path_to_error::Segment;
    path.iter().fold(at.to_owned(), |place, segment| match segment {
        Segment::Seq { index } => format!("{place}/{index}"),
        Segment::Map { key } => member(&place, key),
        Segment::Enum { .. } | Segment::Unknown => place,
    })
}
