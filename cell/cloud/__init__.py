"""Point clouds with the positions they were taken from, as a recording.

PLY files and viewpoints go in; a recording with a virtual depth image for each viewpoint comes out. `import_cloud`
does it, and `CloudRequest` holds what its caller knows.
"""

from cell.cloud.errors import CloudError
from cell.cloud.import_cloud import CloudRequest, ImportedCloud, import_cloud

__all__ = ["CloudError", "CloudRequest", "ImportedCloud", "import_cloud"]
