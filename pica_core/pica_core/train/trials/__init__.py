"""Many short trainings compared: recipes, failures, and where a step's time goes."""
