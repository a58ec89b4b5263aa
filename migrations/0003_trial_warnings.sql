-- What must be read before a trial is used, found at its upload (a JSON list of {code, message}); trials of before have
-- none, since nothing was looked for. SHA-256 of r, u, y and d alone, without times: the same signals in another format.
ALTER TABLE trials ADD COLUMN warnings TEXT NOT NULL DEFAULT '[]';
ALTER TABLE trials ADD COLUMN signals_sha256 TEXT;
CREATE INDEX trials_by_signals ON trials (subject_id, signals_sha256);
