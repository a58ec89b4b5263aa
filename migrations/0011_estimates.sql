-- What a report says of each of its trials by each estimator, as learning curves and mean controllers take it (JSON), so
-- that neither opens a report. Written in the transaction that finishes the analysis.
CREATE TABLE analysis_estimates (
    analysis_id TEXT    NOT NULL REFERENCES analyses (id) ON DELETE CASCADE,
    -- The place of the trial among those of the analysis.
    position    INTEGER NOT NULL CHECK (position >= 0),
    estimator   TEXT    NOT NULL,
    estimate    TEXT    NOT NULL,
    sha256      TEXT    NOT NULL CHECK (length(sha256) = 64),
    PRIMARY KEY (analysis_id, position, estimator)
) STRICT, WITHOUT ROWID;

-- Reports of before are read once more when the program starts.
UPDATE analyses SET trust_rule = NULL WHERE trust_rule IS NOT NULL;
