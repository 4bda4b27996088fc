"""Exchange of networks with other libraries, through the Neuromorphic Intermediate Representation (NIR)."""
