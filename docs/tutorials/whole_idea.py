# %% [markdown]
# # The whole idea on one sheet
#
# A blendshape rig says where a skin should go. SoftDECA (Wagner, Schwanecke, Botsch, MIG 2023) asks where it goes as
# the outside of flesh on bone. This page answers with numpy and scipy alone. Equations have the paper's numbers; a
# table at the end says where the package has each. Units are mm, mN and kPa.
#
# A head is a neutral skin and three closed surfaces of one triangulation: around skin, muscles and skull (Eq. 1).
# `softdeca head fit` makes it (Eq. 2 to 5) and writes its arrays. Between the surfaces lie prisms, each split into
# three tets. Diagonals run from a smaller vertex outside to a larger one inside, so neighbours agree.

# %%
import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg, splu
from scipy.spatial.transform import Rotation


def read_head(path):
    """Read a head's arrays; shapes (52, n, 3) [mm] are what each weight adds to the skin."""
    head = dict(np.load(path))
    for name in ("wrap_from_skin", "skin_from_wrap"):
        parts = (head[f"{name}.{part}"] for part in ("data", "indices", "indptr"))
        head[name] = sparse.csr_matrix(tuple(parts))
    head["shapes"] = head["rig.deltas"].astype(float)
    return head


def split_prisms(triangles, outer, inner, vertices):
    """Make three tets (3 m, 4) of each prism between vertices outer + v and inner + v."""
    (a, b, c), (d, e, f) = (first + np.sort(triangles).T for first in (outer, inner))
    tets = np.array([(a, b, c, f), (a, b, e, f), (a, d, e, f)])
    tets = tets.transpose(0, 2, 1).reshape(-1, 4)
    mirrored = np.linalg.det(vertices[tets[:, 1:]] - vertices[tets[:, :1]]) < 0
    tets[mirrored] = tets[mirrored][:, [0, 2, 1, 3]]
    return tets


# %% [markdown]
# ## Energies of stretches
#
# A tet's energy depends on its deformation gradient F = U diag(s) Vᵀ through the stretches s alone. A law is a function
# of s. It returns the energy ψ, the principal stresses p = dψ/ds, and dp/ds. *Strain* (Eq. 10) draws s to 1, or between
# 1/ε and a threshold ε. *Volume* (Eq. 10 and 12) draws s to the nearest t of product v: there tᵢ (tᵢ - sᵢ) is one m for
# all three, so tᵢ = (sᵢ + √(sᵢ² + 4m)) / 2, and one equation is left. *Skin* (Eq. 11) is strain in a plane.


# %%
def squared(weight, away, slope):
    """The law weight/2 |away|², where slope = d(away)/ds."""
    psi = weight / 2 * np.sum(away**2, axis=1)
    return psi, weight[:, None] * away, weight[:, None, None] * slope


def strain(s, weight, limit):
    away = s - np.clip(s, 1 / limit, limit)
    acts = (s <= 1 / limit) | (s >= limit)
    return squared(weight, away, acts[:, :, None] * np.eye(3))


def volume(s, weight, v):
    """The law weight/2 |s - t|², t the nearest stretches whose product is v."""
    # Newton's method for ln(t₀ t₁ t₂ / v) = 0, by t₂; flat and inverted tets begin upright.
    area, last, t = s[:, 0] * s[:, 1], s[:, 2], s.copy()
    t[:, 2] = np.where(area * last < 0.2 * v, 0.5 * v / (area + 0.3 * v), last)
    for _ in range(12):
        root = np.sqrt(s**2 + 4 * (t * (t - s))[:, 2:])
        t[:, :2] = (s + root)[:, :2] / 2
        product = t.prod(axis=1)
        ratio = 2 * (v - product) / (v + product)  # about ln(v / product)
        others = np.sum(1 / (t * root)[:, :2], axis=1)
        change = ratio / (1 / t[:, 2] + (2 * t[:, 2] - last) * others)
        t[:, 2] = np.maximum(t[:, 2] + change, t[:, 2] / 2)
    # Both equations give dt = steep (t ds + dm) with Σ dt / t = 0.
    steep = 1 / (2 * t - s)
    share = steep / np.sum(steep / t, axis=1)[:, None]
    dt = (steep * t)[:, :, None] * np.eye(3) - steep[:, :, None] * share[:, None]
    return squared(weight, s - t, np.eye(3) - dt)


def skin_strain(s, weight):
    plane = np.array([1.0, 1.0, 0.0])
    return squared(weight, plane * (s - 1), np.diag(plane))


# %% [markdown]
# ## Elements
#
# A linear element has one F: the sum over its corners of xₐ ⊗ Gₐ, with the slopes G of its shape functions. That of a
# triangle has the third stretch zero, along its normal. The derivative of the stress is known in the frame of U and V:
# dp/ds between the stretches, and for each two axes a twist (pᵢ + pⱼ)/(sᵢ + sⱼ) and a flip (pᵢ - pⱼ)/(sᵢ - sⱼ) (Smith,
# de Goes, Kim 2019). Where these are negative and raised to zero, steps lead downhill.


# %%
class Elements:
    """Tets or triangles (k, 4 or 3), a law, and a stiffness (k,) that bounds its slope."""

    def __init__(self, rest, corners):
        edges = rest[corners[:, 1:]] - rest[corners[:, :1]]
        gram = np.linalg.det(edges @ edges.transpose(0, 2, 1))
        self.size = np.sqrt(gram) / (6 if edges.shape[1] == 3 else 2)
        slopes = np.linalg.pinv(edges)
        first = -slopes.sum(axis=2, keepdims=True)
        self.slopes = np.concatenate([first, slopes], axis=2)
        columns = np.repeat(corners, 3, axis=0).ravel()
        starts = np.arange(0, len(columns) + 1, corners.shape[1])
        shape = len(starts) - 1, len(rest)
        self.to_F = sparse.csr_matrix((self.slopes.ravel(), columns, starts), shape)

    def stretch(self, x):
        """F = U diag(s) Vᵀ by rotations; the last s is negative where a tet is inverted."""
        F = (self.to_F @ x).reshape(-1, 3, 3).transpose(0, 2, 1)
        U, s, Vt = np.linalg.svd(F)
        sign = np.where(np.linalg.det(U) * np.linalg.det(Vt) < 0, -1.0, 1.0)
        U[:, :, 2] *= sign[:, None]
        s[:, 2] *= sign
        return U, s, Vt

    def energy(self, x):
        """Energy [µJ] at positions x (n, 3) [mm], and its gradient (n, 3) [mN]."""
        U, s, Vt = self.stretch(x)
        psi, p, _ = self.law(s)
        stress = self.size[:, None, None] * (U * p[:, None]) @ Vt
        forces = stress.transpose(0, 2, 1).reshape(-1, 3)
        return self.size @ psi, self.to_F.T @ forces

    def hessian(self, x, raised):
        """The second derivative (3 n, 3 n) [mN/mm], with negative values raised or not."""
        U, s, Vt = self.stretch(x)
        _, p, slope = self.law(s)
        frame = np.zeros((len(s), 9, 9))  # of Uᵀ dF V, whose entry (i, j) is 3 i + j
        frame[:, [[0], [4], [8]], [0, 4, 8]] = slope
        for i, j in ((0, 1), (0, 2), (1, 2)):
            total, apart = s[:, i] + s[:, j], s[:, i] - s[:, j]
            twist = (p[:, i] + p[:, j]) / np.where(abs(total) > 1e-9, total, 1e-9)
            flip = (p[:, i] - p[:, j]) / np.maximum(apart, 1e-6)
            flip = np.where(apart > 1e-6, flip, slope[:, i, i] - slope[:, i, j])
            if raised:
                twist, flip = np.maximum(twist, 0), np.maximum(flip, 0)
            ij, ji = 3 * i + j, 3 * j + i
            frame[:, [ij, ji], [ij, ji]] = (flip + twist)[:, None] / 2
            frame[:, [ij, ji], [ji, ij]] = (flip - twist)[:, None] / 2
        turn = np.einsum("kri,klj->kiljr", U, Vt).reshape(-1, 9, 9)
        blocks = self.size[:, None, None] * turn.transpose(0, 2, 1) @ frame @ turn
        blocks = sparse.bsr_matrix((blocks, np.arange(len(s)), np.arange(len(s) + 1)))
        to_F = sparse.kron(self.to_F, np.eye(3), format="csr")
        return to_F.T @ (blocks @ to_F)


# %% [markdown]
# ## A problem
#
# The energy (Eq. 15) is the sum over all elements, springs that draw vertices to goals (Eq. 14), and dead forces. The
# paper's skull is a stiff surface that moves rigidly (Eq. 13). Here it is rigid: the cranium is held, and the mandible
# has six unknowns, a shift and a turn. Muscle ends on the skull's surface, so no connecting tets are needed. In a take
# the skin seeks γ S + 2α T₋₁ - β T₋₂ in place of S (Eq. 9), by springs k/γ; γ + 2α - β = 1 lets a face at rest rest.


# %%
class Problem:
    """Elements, springs (n,) [mN/mm] to goals (n, 3) [mm], forces (n, 3) [mN], and bones."""

    def __init__(self, rest, elements, springs, goals, forces, held, jaw):
        self.rest, self.elements, self.jaw = rest, elements, jaw
        self.springs, self.goals, self.forces = springs, goals, forces
        self.free = ~held
        self.free[jaw] = False

    def energy(self, x):
        away = x - self.goals
        energy = self.springs @ np.sum(away**2, axis=1) / 2
        energy = energy - np.sum(self.forces * (x - self.rest))
        gradient = self.springs[:, None] * away - self.forces
        for own, pull in (each.energy(x) for each in self.elements):
            energy, gradient = energy + own, gradient + pull
        return energy, gradient

    def motion(self, x):
        """The matrix J of dx = J dq: free vertices, then the jaw's shift and turn."""
        free = sparse.eye(x.size, format="csc")[:, np.repeat(self.free, 3)]
        if not len(self.jaw):
            return free
        arms, body = x[self.jaw] - x[self.jaw].mean(axis=0), np.zeros((*x.shape, 6))
        body[self.jaw, :, :3] = np.eye(3)
        body[self.jaw, :, 3:] = np.cross(np.eye(3), arms[:, None]).transpose(0, 2, 1)
        return sparse.hstack([free, body.reshape(-1, 6)], format="csc")

    def linearise(self, x, raised=False):
        """J, and gradient and Hessian by q, less the share of the jaw's own curved path."""
        J, K = self.motion(x), sparse.diags(np.repeat(self.springs, 3))
        K = K + sum(each.hessian(x, raised) for each in self.elements)
        return J, J.T @ self.energy(x)[1].ravel(), J.T @ K @ J

    def move(self, x, step):
        moved, count = x.copy(), 3 * np.count_nonzero(self.free)
        moved[self.free] += step[:count].reshape(-1, 3)
        if len(self.jaw):
            middle, (shift, turn) = x[self.jaw].mean(axis=0), step[count:].reshape(2, 3)
            arms = Rotation.from_rotvec(turn).apply(x[self.jaw] - middle)
            moved[self.jaw] = middle + shift + arms
        return moved


PARAMETERS = {
    "soft_stiffness": 5.0,  # w_str = 2 mu [kPa]
    "volume_ratio": 13.5,  # w_vol / w_str, which gives Poisson's ratio 0.45
    "strain_limit": 1.0,  # the threshold ε
    "muscle_strain_ratio": 0.3,  # w_mstr / w_str
    "muscle_volume_ratio": 1.0,
    "skin_stiffness": 20.0,  # w_S [mN/mm]
    "target_stiffness": 10.0,  # w_inv [kPa/mm]
}


def blend(head, weights):
    """S_t of weights (52,): the neutral skin and what each weight adds (Eq. 6 and 7)."""
    return head["skin.vertices"] + np.tensordot(weights, head["shapes"], axes=1)


def facial_problem(head, p, expression):
    """The energy (Eq. 15) of an expression S (skin vertices, 3) [mm] under p."""
    wraps = [head[f"{name}_wrap.vertices"] for name in ("skin", "muscle", "skull")]
    rest, n, triangles = np.vstack(wraps), len(wraps[0]), head["skin_wrap.triangles"]
    tets = [split_prisms(triangles, k * n, (k + 1) * n, rest) for k in (0, 1)]
    tissue, skin = Elements(rest, np.vstack(tets)), Elements(rest, triangles)
    layer = np.repeat([0, 1], len(tets[0]))  # soft tissue, then muscle
    stiff = p["soft_stiffness"] * np.array([1.0, p["muscle_strain_ratio"]])[layer]
    limit = np.array([p["strain_limit"], 1.0])[layer, None]
    bulk = np.array([1.0, p["muscle_volume_ratio"]])[layer]
    bulk = p["volume_ratio"] * p["soft_stiffness"] * bulk
    # Soft tets thinner than 4 mm resist stretches beyond 3, which no face has.
    thin = 4.0 * np.linalg.norm(tissue.slopes, axis=1).max(axis=1) - 1.0
    guard = 20.0 * stiff * np.maximum(thin, 0.0) * (layer == 0)
    membrane = np.full(len(triangles), p["skin_stiffness"])

    def law(s):
        parts = strain(s, stiff, limit), volume(s, bulk, 1.0), strain(s, guard, 3.0)
        return [sum(each) for each in zip(*parts, strict=True)]

    tissue.law, tissue.stiffness = law, stiff + bulk + guard
    skin.law, skin.stiffness = (lambda s: skin_strain(s, membrane)), membrane
    area = np.bincount(triangles.ravel(), np.repeat(skin.size / 3, 3), 3 * n)
    springs, goals = p["target_stiffness"] * area, rest.copy()
    goals[:n] += head["wrap_from_skin"] @ (expression - head["skin.vertices"])
    bone = np.concatenate([np.zeros(2 * n), head["bone"]])
    held, jaw = bone == 1, np.flatnonzero(bone == 2)  # cranium, mandible
    return Problem(rest, [tissue, skin], springs, goals, np.zeros_like(rest), held, jaw)


def in_motion(problem, last, earlier, frequency=4.0, damping=0.3, seconds=1 / 60):
    """The problem (Eq. 9) of a frame after two others (n, 3) [mm], by loose flesh [Hz, 1]."""
    turn = 2 * np.pi * frequency * seconds
    alpha = np.exp(-damping * turn) * np.cos(np.sqrt(1 - damping**2) * turn)
    beta = np.exp(-2 * damping * turn)
    gamma = 1 - 2 * alpha + beta
    goals = gamma * problem.goals + 2 * alpha * last - beta * earlier
    mesh, springs = (problem.rest, problem.elements), problem.springs / gamma
    return Problem(*mesh, springs, goals, problem.forces, ~problem.free, problem.jaw)


def skin_of(head, problem, expression, x):
    """T: the expression, moved by what its wrap is off its goals."""
    off = (x - problem.goals)[: len(head["skin_wrap.vertices"])]
    return expression + head["skin_from_wrap"] @ off


# %% [markdown]
# ## φ†, its derivatives, and the error told
#
# T = φ†(S, p) (Eq. 8) is where the energy is least. *Projective dynamics* factors one matrix, which bounds every law.
# Its local step finds the nearest allowed F of each element: the laws do that. Its global step solves for positions.
# *Newton's method* minimises the same energy by its own second derivative: few steps, each with a factor of its own.
#
# At an answer the gradient is zero, and stays zero as a weight moves the goals: H dx = k ds. One factor gives the
# derivatives by all 52 shapes, and a first frame at the price of blendshapes. How far is a frame from φ†(S, p)? Newton's
# step leads there. Some conjugate gradients find it, helped by the factor at rest, so no frame needs one of its own.


# %%
def factorise(matrix):
    return splu(matrix.tocsc(), "MMD_AT_PLUS_A", 0.0, options={"SymmetricMode": True})


def downhill(problem, x, step):
    """Halve a step until the energy does not rise, but for rounding."""
    energy = problem.energy(x)[0]
    for share in 0.5 ** np.arange(40):
        ahead = problem.move(x, share * step)
        if problem.energy(ahead)[0] <= energy + 1e-13 * abs(energy):
            return ahead
    return x


def projective_dynamics(problem, x, iterations):
    """Take local and global steps in turn (Bouaziz et al. 2014)."""
    matrix = sparse.diags(problem.springs)
    for each in problem.elements:
        weight = sparse.diags(np.repeat(each.size * each.stiffness, 3))
        matrix = matrix + each.to_F.T @ weight @ each.to_F
    J = problem.motion(problem.rest)
    factor = factorise(J.T @ sparse.kron(matrix, np.eye(3)) @ J)
    for _ in range(iterations):
        gradient = problem.motion(x).T @ problem.energy(x)[1].ravel()
        x = downhill(problem, x, -factor.solve(gradient))
    return x


def newton(problem, x, accuracy=1e-7):
    """Take Newton's steps until one is shorter than an accuracy [mm], far away by the raised matrix."""
    raised = True
    for _ in range(100):
        J, gradient, H = problem.linearise(x, raised)
        step = -factorise(H).solve(gradient)
        x, size = downhill(problem, x, step), abs(J @ step).max()
        if size < accuracy:
            return x
        raised = size > 0.1
    raise RuntimeError("Newton's method has not converged")


def derivatives(head, problem, x):
    """Return the factor of H at an answer x, and dx/dw (52, n, 3) [mm]."""
    pull, n = np.zeros((52, *x.shape)), len(head["bone"])
    pull[:, :n] = [head["wrap_from_skin"] @ shape for shape in head["shapes"]]
    pull *= problem.springs[:, None]
    J, _, H = problem.linearise(x)
    factor = factorise(H)
    moved = J @ factor.solve(J.T @ pull.reshape(52, -1).T)
    return factor, moved.T.reshape(pull.shape)


def distance_left(problem, x, factor):
    """Estimate how far x is from the answer (n, 3) [mm]."""
    J, gradient, H = problem.linearise(x)
    before = LinearOperator(H.shape, factor.solve)
    return (J @ cg(H, -gradient, M=before, maxiter=10)[0]).reshape(-1, 3)


# %% [markdown]
# ## A mouth opens: the package fits the head, and solves the same frame

# %%
if __name__ == "__main__":
    from pathlib import Path
    from tempfile import TemporaryDirectory

    from softdeca.lhm import expressions, fit_head, identities, load_template
    from softdeca.lhm.head.file import load_head, save_head
    from softdeca.reference import Face, solve

    with TemporaryDirectory() as folder:
        file = Path(folder) / "head.npz"
        save_head(file, fit_head(load_template(level=1), identities.Anny().mean))
        head, layered = read_head(file), load_head(file)
    weights = expressions.parse_weights("jawOpen")
    S = blend(head, weights)
    problem = facial_problem(head, PARAMETERS, S)
    factor, by_weights = derivatives(head, problem, problem.rest)
    frames = {
        "derivatives": problem.rest + np.tensordot(weights, by_weights, axes=1),
        "projective dynamics": projective_dynamics(problem, problem.rest, 10),
    }
    frames["Newton"] = answer = newton(problem, frames["projective dynamics"])
    T = skin_of(head, problem, S, answer)
    for name, x in frames.items():
        left = distance_left(problem, x, factor)[: len(head["bone"])]
        told = np.linalg.norm(head["skin_from_wrap"] @ left, axis=1).mean()
        true = np.linalg.norm(skin_of(head, problem, S, x) - T, axis=1).mean()
        print(f"{name:<20} told error {told:.1e} mm, true error {true:.1e} mm")

    closing = facial_problem(head, PARAMETERS, head["skin.vertices"])
    earlier = last = answer
    for frame in range(3):
        moving = in_motion(closing, last, earlier)
        earlier, last = last, projective_dynamics(moving, last, 5)
        away = abs(last - closing.rest)[closing.jaw].max()
        print(f"frame {frame} after the mouth is let go: the jaw is {away:.1f} mm away")

    face = Face(layered, layered.rig.deltas, choices={"cells": "tets"})
    theirs = solve(face.scene(weights), absolute=1e-6).positions
    apart = np.abs(T - face.skin_after(weights, theirs)).max()
    print(f"the package's skin is at most {apart:.0e} mm from this one's")
    assert apart < 1e-8

# %% [markdown]
# ## Where the package has it
#
# | here | there |
# |---|---|
# | `read_head`, `split_prisms` | `lhm/head/file.py`, `lhm/head/layers.py`; Eq. 2 to 5: `lhm/template/fit.py` |
# | `strain`, `volume`, `skin_strain` | `reference/terms/`, `reference/projective/terms/`; laws: `reference/materials/` |
# | `Problem` | `reference/scene.py`, `reference/projective/unknowns/coordinates.py` |
# | `blend`, `skin_of` | `reference/face/face.py`; p where it changes the neutral face: `reference/face/settle.py` |
# | `facial_problem` | `reference/face/facial.py`; soft bones, connecting tets: `bones.py`, `tissue.py` there |
# | `projective_dynamics`, `newton` | `reference/projective/`, with contact (3.3.2); finite elements: `reference/fenicsx/` |
# | `derivatives`, `distance_left` | `reference/face/derivatives.py`; `surrogate/certified.py` |
# | `in_motion` | `reference/face/dynamics.py`, `reference/face/sequence.py` |
# | the network (Eq. 16 to 21) | `surrogate/networks/` |
