//! The order in which work is taken.

/// A place at the end of a line of the queue: each kind of each study has one, and lines take turns, since they are
/// counted from the head of the queue. A run of thousands so delays neither another study nor a short analysis of
/// another kind. Counted, since a clock may be set.
macro_rules! end_of_line {
    ($study:literal, $kind:literal) => {
        concat!(
            "(SELECT 1 + max(
                coalesce((SELECT min(place) - 1 FROM analyses INDEXED BY analyses_queue WHERE status = 'queued'),
                    (SELECT max(place) FROM analyses INDEXED BY analyses_leased WHERE status = 'running'), 0),
                coalesce((SELECT max(place) FROM analyses INDEXED BY analyses_lines
                    WHERE status = 'queued' AND study_id IS ",
            $study,
            " AND kind = ",
            $kind,
            "), 0)))"
        )
    };
}
pub(super) use end_of_line;

/// The first in the queue that may be taken. Rescued work waits; a time of day before it began to do so has been set
/// back, and it does not wait for that.
macro_rules! next_in_line {
    ($now:literal) => {
        concat!(
            "(SELECT id FROM analyses INDEXED BY analyses_queue
                WHERE status = 'queued' AND NOT (available_at > ",
            $now,
            " AND available_at - wait_us <= ",
            $now,
            ") ORDER BY place, rowid LIMIT 1)"
        )
    };
}

/// Takes the next in line. The indexes of the queue are named, here and above: the database would take that of all rows
/// in a status, and sort them.
pub(super) const CLAIM: &str = concat!(
    "UPDATE analyses SET status = 'running', attempts = attempts + 1, lease_token = $1, lease_expires_at = $2,
        worker = $3, started_at = $4, progress_done = 0, progress_total = 0, progress_at = $4, phase = 'computing',
        phase_from = 0, phase_to = 1, fraction = 0, phase_began_at = $4, eta_s = NULL, incumbent_cost = NULL,
        incumbent_index = NULL, lower_bound = NULL, incumbent = NULL, version = version + 1, updated_at = $4,
        beat = beat + 1, lease_us = $5
     WHERE id = ",
    next_in_line!("$4"),
    " AND status = 'queued' RETURNING id, request, request_sha256, attempts, beat"
);

/// The signs of life of everything that is under way.
pub(super) const RUNNING: &str =
    "SELECT id, lease_token, beat, lease_us FROM analyses INDEXED BY analyses_leased WHERE status = 'running'";
