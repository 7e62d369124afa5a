"""What matchers pose and solvers solve: costs and residuals over poses."""
