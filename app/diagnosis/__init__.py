"""Why a filter lost its hypotheses, and whether it was consistent: the evidence of a run, and what that says."""
