"""Other programs' files: bags, clouds and depth images in; point clouds and tables of models out."""
