-- Estimates by prediction errors keep their controllers now, which mean responses are drawn from: reports of before are read once
-- more when the program starts.
UPDATE analyses SET trust_rule = NULL WHERE trust_rule IS NOT NULL AND kind = 'prediction_error';
