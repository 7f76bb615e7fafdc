"""The network: unknowns, observations, normal equations, solution and its statistics."""
