"""Networks as pure functions of named arrays, their weights, and one trainer: a file each.

| file           | T - S                                                | of           |
|----------------|------------------------------------------------------|--------------|
| modal          | `tables` that are mixed, and modes; what is shipped  | this project |
| hypernetwork   | z(w) L(p, h) by deformation gradients; ours beyond `tables` | SoftDECA |
| recurrence     | α, β and γ of frames with inertia                    | SoftDECA     |
| vertices_only  | z(w) L(p, h) at each vertex                          | SoftDECA's ablation |
| face_wise      | a network at each face, in each frame                | SoftDECA's ablation |
| softsmpl       | one perceptron of w, p and h to all faces            | SoftSMPL     |
| softsmpl_gru   | the same with a GRU, of sequences                    | SoftSMPL     |
| snp            | sequences alone, step by step in one subspace        | Subspace Neural Physics |

`table_training` trains the tables of `modal` and of our hypernetwork, `modal_training` the rest of the first.
`gradients` has what those of deformation gradients share at run time, `gradient_training` how they are trained, and
`frames` the batches.
"""
