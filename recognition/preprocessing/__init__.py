"""From depth images to point clouds of what lies above the table, with normals, view by view."""
