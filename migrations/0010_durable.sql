-- Signs of life are counted, and judged on the clock of whoever watches that cannot be set; the queue has its own
-- order. So a clock that jumps neither kills a worker nor hides or reorders work. `lease_expires_at` and
-- `available_at` stay for people.
ALTER TABLE analyses ADD COLUMN beat INTEGER NOT NULL DEFAULT 0;
ALTER TABLE analyses ADD COLUMN lease_us INTEGER NOT NULL DEFAULT 15000000 CONSTRAINT lease_lasts CHECK (lease_us > 0);
ALTER TABLE analyses ADD COLUMN place INTEGER NOT NULL DEFAULT 0;
-- How long rescued work waits. It began to at `available_at - wait_us`: a clock before that has been set back.
ALTER TABLE analyses ADD COLUMN wait_us INTEGER NOT NULL DEFAULT 0 CONSTRAINT wait_passes CHECK (wait_us >= 0);
UPDATE analyses SET place = line.place
    FROM (SELECT id, row_number() OVER (ORDER BY available_at, id) AS place
          FROM analyses WHERE status IN ('queued', 'running')) AS line
    WHERE line.id = analyses.id;
DROP INDEX analyses_queue;
CREATE INDEX analyses_queue ON analyses (place) WHERE status = 'queued';
CREATE INDEX analyses_lines ON analyses (study_id, kind, place) WHERE status = 'queued';
DROP INDEX analyses_leased;
CREATE INDEX analyses_leased ON analyses (place) WHERE status = 'running';

-- Lists look at these columns, and not at rows with their reports: a page of a hundred costs a hundred rows.
DROP INDEX trials_by_subject;
CREATE INDEX trials_by_subject ON trials (subject_id, id);
DROP INDEX analyses_by_study;
CREATE INDEX analyses_by_study ON analyses (study_id, id, kind, status);
DROP INDEX analyses_by_status;
CREATE INDEX analyses_by_status ON analyses (status, id, kind);
CREATE INDEX analyses_by_kind ON analyses (kind, id, status);
CREATE INDEX analyses_of_run ON analyses (study_id, kind, spec_sha256, status, finished_at, started_at);
CREATE INDEX idempotency_keys_by_age ON idempotency_keys (created_at);

-- One row that readiness changes, since only a commit proves that the next one can succeed.
CREATE TABLE readiness (
    id      INTEGER NOT NULL PRIMARY KEY CHECK (id = 1),
    commits INTEGER NOT NULL
) STRICT;
INSERT INTO readiness (id, commits) VALUES (1, 0);

-- SHA-256 of `metrics`; NULL where the trial was stored before there was one.
ALTER TABLE trials ADD COLUMN metrics_sha256 TEXT;

-- What verification found damaged: which row of which table, where in it, and why.
CREATE TABLE quarantine (
    noun     TEXT    NOT NULL,
    row_id   TEXT    NOT NULL,
    why      TEXT    NOT NULL,
    found_at INTEGER NOT NULL,
    PRIMARY KEY (noun, row_id)
) STRICT;
