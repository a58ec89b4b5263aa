-- Volition's first schema: the lab's world (studies, plants, subjects, trials) and the analyses, whose rows are the jobs.
--
-- Conventions: ids are UUIDv7 in lower-case text, so that the order of ids is the order of creation and keyset lists
-- need no other key; times are integer microseconds since 1970 UTC; JSON is text; every `version` counts changes from 1
-- and is the ETag. STRICT tables, because a text in a number column would surface as a wrong number much later.

-- Tells our files from other programs' ("VOLT").
PRAGMA application_id = 1448037460;

CREATE TABLE studies (
    id            TEXT    NOT NULL PRIMARY KEY,
    name          TEXT    NOT NULL,
    description   TEXT    NOT NULL,
    -- A trial whose |y| passes this is divergent. Divergence itself is not stored: the limit may change.
    display_limit REAL    CHECK (display_limit > 0),
    version       INTEGER NOT NULL DEFAULT 1,
    created_at    INTEGER NOT NULL,
    updated_at    INTEGER NOT NULL
) STRICT;

CREATE TABLE plants (
    id         TEXT    NOT NULL PRIMARY KEY,
    study_id   TEXT    NOT NULL REFERENCES studies (id) ON DELETE CASCADE,
    name       TEXT    NOT NULL,
    model      TEXT    NOT NULL,
    -- A digit that changed on disk would still be a model; results would be wrong and look right.
    model_sha256 TEXT  NOT NULL CHECK (length(model_sha256) = 64),
    version    INTEGER NOT NULL DEFAULT 1,
    created_at INTEGER NOT NULL,
    updated_at INTEGER NOT NULL,
    -- Lets trials prove by foreign key that plant and subject are of one study.
    UNIQUE (id, study_id)
) STRICT;
CREATE UNIQUE INDEX plant_name_taken ON plants (study_id, name);
CREATE INDEX plants_by_study ON plants (study_id, id);

CREATE TABLE subjects (
    id         TEXT    NOT NULL PRIMARY KEY,
    study_id   TEXT    NOT NULL REFERENCES studies (id) ON DELETE CASCADE,
    -- A pseudonym; names of people do not belong here.
    code       TEXT    NOT NULL,
    group_name TEXT,
    attributes TEXT    NOT NULL,
    version    INTEGER NOT NULL DEFAULT 1,
    created_at INTEGER NOT NULL,
    updated_at INTEGER NOT NULL,
    UNIQUE (id, study_id)
) STRICT;
CREATE UNIQUE INDEX subject_code_taken ON subjects (study_id, code);
CREATE INDEX subjects_by_study ON subjects (study_id, id);

CREATE TABLE trials (
    id              TEXT    NOT NULL PRIMARY KEY,
    -- Repeats the subject's study, so that the two foreign keys below can hold subject and plant together.
    study_id        TEXT    NOT NULL,
    subject_id      TEXT    NOT NULL,
    plant_id        TEXT    NOT NULL,
    number          INTEGER NOT NULL CHECK (number >= 1),
    session         INTEGER,
    sample_time_s   REAL    NOT NULL CHECK (sample_time_s > 0),
    samples         INTEGER NOT NULL CHECK (samples >= 0),
    has_disturbance INTEGER NOT NULL CHECK (has_disturbance IN (0, 1)),
    -- Of the recording: sample time and every column by its bits. Checked again whenever the signals are read.
    sha256          TEXT    NOT NULL CHECK (length(sha256) = 64),
    max_abs_output  REAL    NOT NULL CHECK (max_abs_output >= 0),
    metrics         TEXT    NOT NULL,
    version         INTEGER NOT NULL DEFAULT 1,
    created_at      INTEGER NOT NULL,
    updated_at      INTEGER NOT NULL,
    FOREIGN KEY (subject_id, study_id) REFERENCES subjects (id, study_id) ON DELETE CASCADE,
    -- No cascade: deleting a plant must not take recordings with it. NO ACTION rather than RESTRICT, since it is checked
    -- at the end of the statement and so lets a whole study go in one DELETE.
    FOREIGN KEY (plant_id, study_id) REFERENCES plants (id, study_id)
) STRICT;
-- Two indexes, because NULL sessions are distinct from one another in a plain one.
CREATE UNIQUE INDEX trial_number_taken_in_session ON trials (subject_id, session, number) WHERE session IS NOT NULL;
CREATE UNIQUE INDEX trial_number_taken ON trials (subject_id, number) WHERE session IS NULL;
CREATE UNIQUE INDEX trial_content_taken ON trials (subject_id, sha256);
CREATE INDEX trials_by_subject ON trials (subject_id, study_id, id);
CREATE INDEX trials_by_plant ON trials (plant_id, study_id);
CREATE INDEX trials_by_content ON trials (study_id, sha256);

-- One row per recorded column, so that a reader of y alone need not unpack the rest, and metadata queries stay small.
CREATE TABLE trial_signals (
    trial_id TEXT    NOT NULL REFERENCES trials (id) ON DELETE CASCADE,
    channel  TEXT    NOT NULL CHECK (channel IN ('t', 'r', 'u', 'y', 'd')),
    -- How `data` is packed; a later version may add another codec beside the old rows.
    codec    TEXT    NOT NULL CHECK (codec IN ('pco1')),
    samples  INTEGER NOT NULL CHECK (samples >= 0),
    -- SHA-256 of `data`: damage is found before the codec sees it.
    sha256   TEXT    NOT NULL CHECK (length(sha256) = 64),
    data     BLOB    NOT NULL,
    PRIMARY KEY (trial_id, channel)
) STRICT;

-- An analysis, and at once its job: one row, so that there is no second source of truth about what is to be done.
-- The CHECKs repeat the rule of `jobs::Job::apply` for every writer, this program or not.
CREATE TABLE analyses (
    id               TEXT    NOT NULL PRIMARY KEY,
    -- NULL where the request carries its data itself.
    study_id         TEXT    REFERENCES studies (id) ON DELETE CASCADE,
    kind             TEXT    NOT NULL,
    request          TEXT    NOT NULL,
    request_sha256   TEXT    NOT NULL CHECK (length(request_sha256) = 64),
    spec_sha256      TEXT    NOT NULL,
    status           TEXT    NOT NULL CHECK (status IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    attempts         INTEGER NOT NULL DEFAULT 0 CHECK (attempts >= 0),
    -- Place in the queue: the oldest that is not in the future is next. Rescued work gets a later one.
    available_at     INTEGER NOT NULL,
    lease_token      TEXT,
    lease_expires_at INTEGER,
    -- Who holds it, or held it last.
    worker           TEXT,
    cancel_requested INTEGER NOT NULL DEFAULT 0 CHECK (cancel_requested IN (0, 1)),
    progress_done    INTEGER NOT NULL DEFAULT 0,
    progress_total   INTEGER NOT NULL DEFAULT 0,
    -- When progress was last reported and when the present count began: what `jobs::EtaEstimator` needs.
    progress_at      INTEGER,
    phase_began_at   INTEGER,
    eta_s            REAL    CHECK (eta_s >= 0),
    -- The exact bytes that the worker wrote, and their SHA-256.
    report           TEXT,
    report_sha256    TEXT,
    problem          TEXT,
    version          INTEGER NOT NULL DEFAULT 1,
    created_at       INTEGER NOT NULL,
    started_at       INTEGER,
    finished_at      INTEGER,
    updated_at       INTEGER NOT NULL,
    CONSTRAINT finished_when_final  CHECK ((finished_at IS NOT NULL) = (status IN ('succeeded', 'failed', 'cancelled'))),
    CONSTRAINT leased_when_running  CHECK ((lease_token IS NOT NULL) = (status = 'running')
                                       AND (lease_expires_at IS NOT NULL) = (status = 'running')),
    CONSTRAINT attempted_when_taken CHECK (attempts >= 1 OR status IN ('queued', 'cancelled')),
    CONSTRAINT started_when_taken   CHECK (started_at IS NOT NULL OR status IN ('queued', 'cancelled')),
    CONSTRAINT reported_on_success  CHECK ((report IS NOT NULL) = (status = 'succeeded')
                                       AND (report_sha256 IS NOT NULL) = (status = 'succeeded')),
    CONSTRAINT problem_on_failure   CHECK ((problem IS NOT NULL) = (status = 'failed')),
    CONSTRAINT cancelled_on_request CHECK (status <> 'cancelled' OR cancel_requested = 1),
    CONSTRAINT queued_means_wanted  CHECK (status <> 'queued' OR cancel_requested = 0),
    CONSTRAINT progress_in_range    CHECK (0 <= progress_done AND progress_done <= progress_total)
) STRICT;
-- The claim's and the rescue's indexes hold only the rows that they look for; finished work costs them nothing.
CREATE INDEX analyses_queue ON analyses (available_at, id) WHERE status = 'queued';
CREATE INDEX analyses_leased ON analyses (lease_expires_at) WHERE status = 'running';
CREATE INDEX analyses_by_study ON analyses (study_id, id);
CREATE INDEX analyses_by_status ON analyses (status, id);

-- What an analysis used. Its results are about those trials: a report that outlived a deleted recording would keep a
-- person's data after its deletion was promised. So an analysis goes with the first of its trials (or plants) that goes.
CREATE TABLE analysis_trials (
    analysis_id TEXT    NOT NULL REFERENCES analyses (id) ON DELETE CASCADE,
    position    INTEGER NOT NULL CHECK (position >= 0),
    trial_id    TEXT    NOT NULL REFERENCES trials (id) ON DELETE CASCADE,
    PRIMARY KEY (analysis_id, position)
) STRICT;
CREATE UNIQUE INDEX analysis_trials_by_trial ON analysis_trials (trial_id, analysis_id);

CREATE TABLE analysis_plants (
    analysis_id TEXT    NOT NULL REFERENCES analyses (id) ON DELETE CASCADE,
    position    INTEGER NOT NULL CHECK (position >= 0),
    plant_id    TEXT    NOT NULL REFERENCES plants (id) ON DELETE CASCADE,
    PRIMARY KEY (analysis_id, position)
) STRICT;
CREATE UNIQUE INDEX analysis_plants_by_plant ON analysis_plants (plant_id, analysis_id);

-- Cascades reach these tables from trials, subjects and studies alike; the triggers carry them on to the analysis.
CREATE TRIGGER analysis_goes_with_its_trial AFTER DELETE ON analysis_trials
BEGIN
    DELETE FROM analyses WHERE id = OLD.analysis_id;
END;
CREATE TRIGGER analysis_goes_with_its_plant AFTER DELETE ON analysis_plants
BEGIN
    DELETE FROM analyses WHERE id = OLD.analysis_id;
END;

-- Keys that make a repeated POST harmless. One request can make many rows, hence a table of its own, written in the
-- transaction that makes them. Only the hash of the client's key is kept: people put subject codes into keys, and keys
-- outlive the subject.
CREATE TABLE idempotency_keys (
    -- The route with its parent: the same key means something else elsewhere.
    scope          TEXT    NOT NULL,
    key_sha256     TEXT    NOT NULL,
    request_sha256 TEXT    NOT NULL,
    -- JSON array of the ids made (or recognised as stored already), in the order of the request.
    result_ids     TEXT    NOT NULL,
    created_at     INTEGER NOT NULL,
    PRIMARY KEY (scope, key_sha256)
) STRICT;
