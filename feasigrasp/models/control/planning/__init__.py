"""Planning over the prediction horizon: grasp candidates, cost-to-go, branch switches."""
