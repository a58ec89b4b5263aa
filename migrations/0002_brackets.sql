-- How near a search for a smallest cost is: the smallest cost found so far with the candidate that has it, and what every
-- candidate is proven to cost at least. Written with progress, and kept when the analysis is cancelled or its time has passed.
ALTER TABLE analyses ADD COLUMN incumbent_cost REAL CHECK (incumbent_cost >= 0);
ALTER TABLE analyses ADD COLUMN incumbent_index INTEGER
    CONSTRAINT incumbent_is_one_candidate CHECK (incumbent_index >= 0 AND (incumbent_index IS NULL) = (incumbent_cost IS NULL));
ALTER TABLE analyses ADD COLUMN lower_bound REAL
    CONSTRAINT bracket_is_whole CHECK (0 <= lower_bound AND lower_bound <= incumbent_cost AND (lower_bound IS NULL) = (incumbent_cost IS NULL));
-- The incumbent's controllers as JSON; only where the search was stopped.
ALTER TABLE analyses ADD COLUMN incumbent TEXT
    CONSTRAINT incumbent_has_its_cost CHECK (incumbent IS NULL OR incumbent_cost IS NOT NULL);
