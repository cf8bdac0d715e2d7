// Times the parts of a step of FastCorotatedFEM on a mesh of ours, as JSON. Its sources are compiled beside this file.
//
// Input: counts of vertices, held vertices (which come first) and tets as int64; positions at rest and in the pose as
// float64 (n, 3); corners as int32 (m, 4). Output, besides: rotations after 1 and 5 local steps from none, as float32
// (2, m, 4), each a quaternion x, y, z, w.
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <functional>
#include "FastCorotFEM.h"

using Positions = std::vector<Vector3r>;

static double processor_seconds() {
    timespec now;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return now.tv_sec + 1e-9 * now.tv_nsec;
}

static double median_ms(int repeats, const Positions &pose, const std::function<void(Positions &)> &work) {
    std::vector<double> seconds;
    for (int i = 0; i < repeats; i++) {
        Positions x = pose;
        const double begin = processor_seconds();
        work(x);
        seconds.push_back(processor_seconds() - begin);
    }
    std::nth_element(seconds.begin(), seconds.begin() + repeats / 2, seconds.end());
    return 1e3 * seconds[repeats / 2];
}

static void write_rotations(const FastCorotFEM &simulator, std::ofstream &file) {
    for (int tet = 0; tet < simulator.nTets; tet++)
        for (int c = 0; c < 4; c++) {
            float lanes[8];
            simulator.quats[tet / 8][c].store(lanes);
            file.write(reinterpret_cast<char *>(&lanes[tet % 8]), sizeof(float));
        }
}

int main(int count, char **arguments) {
    if (count != 4) return 2;
    const int repeats = std::stoi(arguments[3]);
    std::ifstream in(arguments[1], std::ios::binary);
    int64_t sizes[3];
    in.read(reinterpret_cast<char *>(sizes), sizeof sizes);
    Positions rest(sizes[0]), pose(sizes[0]);
    for (Positions *places : {&rest, &pose})
        for (Vector3r &x : *places) in.read(reinterpret_cast<char *>(x.data()), 3 * sizeof(double));
    std::vector<std::vector<int>> tets(sizes[2], std::vector<int>(4));
    for (std::vector<int> &tet : tets) in.read(reinterpret_cast<char *>(tet.data()), 4 * sizeof(int));
    if (!in) return 3;

    FastCorotFEM simulator;
    const Real density = 1e-6, mu = 5.0, lambda = 20.0, dt = 0.01;
    const double begin = processor_seconds();
    if (!simulator.initialize(rest, tets, Quaternionr::Identity(), sizes[1], density, mu, lambda, dt)) return 4;
    const double set_up = 1e3 * (processor_seconds() - begin);
    const auto matL = simulator.matL, matLT = simulator.matLT;

    // Without a factor its function that steps does the local step alone.
    simulator.matL.resize(0, 0);
    simulator.matLT.resize(0, 0);
    const auto step_along = [&](Positions &x) { simulator.solveOptimizationProblem(x, tets); };
    std::ofstream out(arguments[2], std::ios::binary);
    for (int times : {1, 4}) {
        for (int i = 0; i < times; i++) {
            Positions x = pose;
            step_along(x);
        }
        write_rotations(simulator, out);
    }
    const double local = median_ms(repeats, pose, step_along);
    simulator.matL = matL;
    simulator.matLT = matLT;
    const double both = median_ms(repeats, pose, step_along);
    const double volume = median_ms(repeats, pose, [&](Positions &x) {
        for (int pass = 0; pass < 2; pass++) simulator.solveVolumeConstraints(x, tets);
    });
    Positions v(rest.size(), Vector3r::Zero());
    const double whole = median_ms(repeats, pose, [&](Positions &x) { simulator.step(x, v, tets, dt); });
    std::printf("{\"set_up\": %g, \"local\": %g, \"global\": %g, \"volume\": %g, \"whole\": %g, \"entries\": %ld}\n",
                set_up, local, both - local, volume, whole, (long)matL.nonZeros());
}
