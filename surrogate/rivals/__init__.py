"""What a network has to beat: methods with one protocol, trained on the same faces, a file each.

| file          | method                                             | needs the simulator at bind |
|---------------|----------------------------------------------------|-----------------------------|
| blendshapes   | T = S                                              | no                          |
| carried       | T = S carried along by the bones that p scales     | no, but a head              |
| linearised    | the settled neutral face, or with 52 responses     | yes                         |
| responses     | both learned by kernel ridge regression            | no                          |
| ridge         | ridge regression of frames, raw or dimensionless   | no                          |
| softsmpl      | one perceptron of w, p and h to all vertices       | no                          |
| vertices_only | z(w) L(p, h) at each vertex                        | no                          |
| face_wise     | a network at each vertex, in each frame            | no                          |
| snp           | sequences alone, step by step in one subspace      | no                          |
| simulated     | PD of few iterations a frame; 52 shapes simulated  | yes                         |
| modal         | the shipped network, alone or with exact responses | no, or yes                  |
"""

from .protocol import Bound, Method, Takes

__all__ = ["Bound", "Method", "Takes"]
