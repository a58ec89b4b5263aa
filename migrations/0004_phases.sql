-- How far a computation is as a share of the whole, and in which phase: what phase it is, which shares of the whole it begins and
-- ends at, and the share that is done, which never falls while an attempt goes on.
ALTER TABLE analyses ADD COLUMN phase TEXT NOT NULL DEFAULT 'computing';
ALTER TABLE analyses ADD COLUMN phase_from REAL NOT NULL DEFAULT 0;
ALTER TABLE analyses ADD COLUMN phase_to REAL NOT NULL DEFAULT 1
    CONSTRAINT phase_is_a_part CHECK (0 <= phase_from AND phase_from <= phase_to AND phase_to <= 1);
ALTER TABLE analyses ADD COLUMN fraction REAL NOT NULL DEFAULT 0
    CONSTRAINT fraction_is_a_share CHECK (0 <= fraction AND fraction <= 1);
UPDATE analyses SET fraction = 1 WHERE status = 'succeeded';
