"""The methods of the paper: the matching method (section II.G) and the enhanced matching method (section III).

The points of the centre line, the registered views and the scene go in. Segments of linked points, strands across the
intersections, and the chains of the model come out.
"""

from recognition.shirakawa.chains import StrandAssembly, assemble_chains
from recognition.shirakawa.end_extension import extend_ends
from recognition.shirakawa.enhanced_matching import EnhancedMatching, match_enhanced, thin
from recognition.shirakawa.matching import match_points
from recognition.shirakawa.method_stages import LinkedSegments, connect_segments, link_segments
from recognition.shirakawa.reconstruction import Reconstruction, reconstruct

__all__ = [
    "EnhancedMatching",
    "LinkedSegments",
    "Reconstruction",
    "StrandAssembly",
    "assemble_chains",
    "connect_segments",
    "extend_ends",
    "link_segments",
    "match_enhanced",
    "match_points",
    "reconstruct",
    "thin",
]
