"""The region graph: references, compiler, plan, and the brain that runs it."""
