#include "peer.hpp"

#include <malloc.h>

#include <cstdio>
#include <ctime>
#include <exception>
#include <fstream>

#include "manip3d/io/mesh_file.hpp"

namespace peers {
namespace {

/// A field of /proc/self/status, in bytes: VmRSS now, VmHWM the most since the last reset.
long status_bytes(const std::string& field) {
  std::ifstream status("/proc/self/status");
  for (std::string word; status >> word;) {
    long kilobytes = 0;
    if (word == field + ":" && status >> kilobytes) return 1024 * kilobytes;
  }
  return 0;
}

void reset_peak() { std::ofstream("/proc/self/clear_refs") << "5"; }

double seconds(clockid_t clock) {
  timespec t{};
  clock_gettime(clock, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

}  // namespace

Cost measure(const std::function<void()>& call) {
  Cost cost;
  malloc_trim(0);  // what loading freed is not to be used again unseen
  reset_peak();
  cost.base_bytes = status_bytes("VmRSS");
  const double cpu = seconds(CLOCK_PROCESS_CPUTIME_ID), wall = seconds(CLOCK_MONOTONIC);
  call();
  cost.cpu_s = seconds(CLOCK_PROCESS_CPUTIME_ID) - cpu;
  cost.wall_s = seconds(CLOCK_MONOTONIC) - wall;
  cost.peak_bytes = status_bytes("VmHWM");
  return cost;
}

int peer_main(int argc, char** argv, const FindMethod& find_method) try {
  if (argc != 5) {
    std::fprintf(stderr, "usage: %s METHOD INPUT TARGET_FACES OUTPUT.ply\n", argv[0]);
    return 2;
  }
  const Method method = find_method(argv[1]);
  if (!method) {
    std::fprintf(stderr, "%s: no such method\n", argv[1]);
    return 2;
  }
  const manip3d::TriangleMesh input = manip3d::read_mesh(argv[2]).mesh;
  Cost cost;
  const manip3d::TriangleMesh output = method(input, std::stoll(argv[3]), cost);
  manip3d::write_mesh(argv[4], output, input.materials);
  std::printf("{\"cpu_s\": %.9f, \"wall_s\": %.9f, \"base_bytes\": %ld, \"peak_bytes\": %ld}\n",
              cost.cpu_s, cost.wall_s, cost.base_bytes, cost.peak_bytes);
  return 0;
} catch (const Refusal& refusal) {
  std::printf("{\"refused\": \"%s\"}\n", refusal.reason.c_str());
  return 0;
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}

}  // namespace peers
