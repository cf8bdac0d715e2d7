"""Networks as pure functions of named arrays, their weights, and one trainer: a file each.

| file           | T - S                                                | of           |
|----------------|------------------------------------------------------|--------------|
| modal          | `tables` that are mixed, and modes; what is shipped  | this project |
| hypernetwork   | z(w) L(p, h) by deformation gradients, printed and ours | SoftDECA  |
| recurrence     | α, β and γ of frames with inertia                    | SoftDECA     |
| vertices_only  | z(w) L(p, h) at each vertex                          | SoftDECA's ablation |
| face_wise      | a network at each face, in each frame                | SoftDECA's ablation |
| softsmpl       | one perceptron of w, p and h to all faces            | SoftSMPL     |
| softsmpl_gru   | the same with a GRU, of sequences                    | SoftSMPL     |
| snp            | sequences alone, step by step in one subspace        | Subspace Neural Physics |
| energy         | all vertices, trained by the energy alone            | Corigliano et al. 2025 |
| ridge          | ridge regression of frames, raw or dimensionless     | a baseline   |
| responses      | offset and responses by kernel ridge regression      | a baseline   |

Offset and responses of `modal` are trained by `table_training`, its remainder by `modal_training`.
`gradients` has what those of deformation gradients share at run time, `gradient_training` how they are trained,
`gradient_start` where our hypernetwork begins, and `frames` the batches.
"""
