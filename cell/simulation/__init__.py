"""A cell without hardware, shipped with the program: string scenes and a ray-cast depth camera."""
