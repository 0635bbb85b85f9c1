// A plain label-correcting eikonal solver: a binary heap of (time, vertex), stale entries skipped when they come up, the local problem
// solved for every other corner of every tetrahedron of the vertex taken off. The yardstick of benches/peers/eikonal.py.
//
// usage: plain_eikonal FOLDER REPEATS: reads points.f64, tetrahedra.i32, fibres.f64 and case.txt (speed, ratio, source vertex) and writes
// plain.f64, the times; prints the processor seconds of every repeat, from the arrays in memory to the times.
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <limits>
#include <queue>
#include <string>
#include <vector>

template <class T> std::vector<T> read(const std::string &path) {
    std::ifstream file(path, std::ios::binary | std::ios::ate);
    if (!file) { std::fprintf(stderr, "%s cannot be read\n", path.c_str()); std::exit(1); }
    std::vector<T> values(size_t(file.tellg()) / sizeof(T));
    file.seekg(0);
    file.read(reinterpret_cast<char *>(values.data()), std::streamsize(values.size() * sizeof(T)));
    return values;
}

struct Vec { double x, y, z; };
static Vec operator-(Vec a, Vec b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }

/// D^-1 / v^2 = (I/ratio + (1 - 1/ratio) f f^T) / v^2, the squared travel time a squared length.
struct Metric {
    double xx, xy, xz, yy, yz, zz;
    double dot(Vec a, Vec b) const {
        return a.x * (xx * b.x + xy * b.y + xz * b.z) + a.y * (xy * b.x + yy * b.y + yz * b.z) + a.z * (xz * b.x + yz * b.y + zz * b.z);
    }
};

static const double NEVER = std::numeric_limits<double>::infinity();
/// Relative fall of a time below which it counts as unchanged: the tolerance of fim-python.
static const double UNCHANGED = 1e-9;

/// min over s in [0, 1] of (1 - s) ta + s tb + |w - (1 - s) a - s b|.
static double through_edge(const Metric &m, Vec a, Vec b, Vec w, double ta, double tb) {
    double best = std::fmin(ta + std::sqrt(m.dot(w - a, w - a)), tb + std::sqrt(m.dot(w - b, w - b)));
    if (ta == NEVER || tb == NEVER) return best;
    // |e - s g| with e = w - a, g = b - a; the derivative vanishes where d |e - s g| = g.e - s g.g
    Vec e = w - a, g = b - a;
    double d = tb - ta, gg = m.dot(g, g), ge = m.dot(g, e), ee = m.dot(e, e);
    double rest = (ee - ge * ge / gg) / (gg - d * d);
    if (!(rest > 0) || gg <= d * d) return best;
    double s = (ge - d * std::sqrt(rest * gg)) / gg;
    if (s <= 0 || s >= 1) return best;
    return std::fmin(best, ta + s * d + std::sqrt(ee - 2 * s * ge + s * s * gg));
}

/// min over the triangle (a, b, c).
static double through_face(const Metric &m, Vec a, Vec b, Vec c, Vec w, double ta, double tb, double tc) {
    if (ta != NEVER && tb != NEVER && tc != NEVER) {
        Vec e = w - a, g = b - a, h = c - a;
        double gg = m.dot(g, g), gh = m.dot(g, h), hh = m.dot(h, h), ge = m.dot(g, e), he = m.dot(h, e), ee = m.dot(e, e);
        double det = gg * hh - gh * gh, dg = tb - ta, dh = tc - ta;
        // foot of w on the plane, and the shift against the times' slope
        double s0 = (hh * ge - gh * he) / det, t0 = (gg * he - gh * ge) / det;
        double s1 = (hh * dg - gh * dh) / det, t1 = (gg * dh - gh * dg) / det;
        double height2 = ee - s0 * ge - t0 * he, slope2 = s1 * dg + t1 * dh;
        if (slope2 < 1 && height2 > 0) {
            double length = std::sqrt(height2 / (1 - slope2));
            double s = s0 - s1 * length, t = t0 - t1 * length;
            if (s >= 0 && t >= 0 && s + t <= 1) return ta + s * dg + t * dh + length;
        }
    }
    double best = through_edge(m, a, b, w, ta, tb);
    best = std::fmin(best, through_edge(m, a, c, w, ta, tc));
    return std::fmin(best, through_edge(m, b, c, w, tb, tc));
}

static std::vector<double> solve(const std::vector<Vec> &points, const std::vector<int32_t> &tets, const std::vector<Vec> &fibres, double speed,
                                 double ratio, int source) {
    size_t count = tets.size() / 4;
    std::vector<Metric> metrics(count);
    for (size_t t = 0; t < count; t++) {
        Vec f = fibres[t];
        double i = 1 / (ratio * speed * speed), k = (1 - 1 / ratio) / (speed * speed);
        metrics[t] = {i + k * f.x * f.x, k * f.x * f.y, k * f.x * f.z, i + k * f.y * f.y, k * f.y * f.z, i + k * f.z * f.z};
    }
    std::vector<int32_t> start(points.size() + 1, 0), holders(tets.size());
    for (int32_t v : tets) start[size_t(v) + 1]++;
    for (size_t v = 0; v < points.size(); v++) start[v + 1] += start[v];
    std::vector<int32_t> next(start.begin(), start.end() - 1);
    for (size_t i = 0; i < tets.size(); i++) holders[size_t(next[size_t(tets[i])]++)] = int32_t(i / 4);

    using Entry = std::pair<double, int32_t>;
    std::priority_queue<Entry, std::vector<Entry>, std::greater<Entry>> heap;
    std::vector<double> time(points.size(), NEVER);
    time[size_t(source)] = 0;
    heap.push({0.0, source});
    while (!heap.empty()) {
        auto [arrival, vertex] = heap.top();
        heap.pop();
        if (arrival > time[size_t(vertex)]) continue;
        for (int32_t i = start[size_t(vertex)]; i < start[size_t(vertex) + 1]; i++) {
            size_t t = size_t(holders[size_t(i)]);
            const int32_t *corner = &tets[4 * t];
            for (int k = 0; k < 4; k++) {
                if (corner[k] == vertex) continue;
                size_t w = size_t(corner[k]), a = size_t(corner[(k + 1) % 4]), b = size_t(corner[(k + 2) % 4]), c = size_t(corner[(k + 3) % 4]);
                if (time[w] <= std::fmin(time[a], std::fmin(time[b], time[c]))) continue;
                double earlier = through_face(metrics[t], points[a], points[b], points[c], points[w], time[a], time[b], time[c]);
                if (earlier < time[w] * (1 - UNCHANGED)) {
                    time[w] = earlier;
                    heap.push({earlier, int32_t(w)});
                }
            }
        }
    }
    return time;
}

int main(int argc, char **argv) {
    if (argc != 3) { std::fprintf(stderr, "usage: plain_eikonal FOLDER REPEATS\n"); return 2; }
    std::string folder = std::string(argv[1]) + "/";
    auto points = read<Vec>(folder + "points.f64"), fibres = read<Vec>(folder + "fibres.f64");
    auto tets = read<int32_t>(folder + "tetrahedra.i32");
    double speed, ratio;
    int source;
    std::ifstream(folder + "case.txt") >> speed >> ratio >> source;
    std::vector<double> time;
    for (int repeat = 0; repeat < std::atoi(argv[2]); repeat++) {
        std::clock_t begin = std::clock();
        time = solve(points, tets, fibres, speed, ratio, source);
        std::printf("%.6f\n", double(std::clock() - begin) / CLOCKS_PER_SEC);
    }
    std::ofstream(folder + "plain.f64", std::ios::binary).write(reinterpret_cast<const char *>(time.data()), std::streamsize(time.size() * sizeof(double)));
}
