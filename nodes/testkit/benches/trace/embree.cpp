// Embree 3 on triangles and rays from files: EMBREE PASSES TRIANGLES RAYS..., all little-endian f32, nine a triangle and
// six a ray (origin, direction). Prints the CPU seconds of building; then, for each number of a set that comes in, the CPU
// seconds of so many passes over it, closest and any, and the hits of one pass. One thread. Robust mode, as our own
// test is watertight; high build quality. `rays.rs` compiles and runs it.
#include <embree3/rtcore.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <vector>

static std::vector<float> floats(const char* path) {
  std::vector<float> values;
  FILE* file = fopen(path, "rb");
  if (!file) return values;
  float value;
  while (fread(&value, 4, 1, file) == 1) values.push_back(value);
  fclose(file);
  return values;
}

static double cpu() {
  timespec t;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int count, char** words) {
  int passes = atoi(words[1]);
  auto triangles = floats(words[2]);
  size_t n = triangles.size() / 9;
  RTCDevice device = rtcNewDevice("threads=1");
  RTCScene scene = rtcNewScene(device);
  rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
  rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_HIGH);
  RTCGeometry mesh = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
  auto vertices = (float*)rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, n * 3);
  auto indices = (unsigned*)rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, n);
  for (size_t i = 0; i < n * 9; i++) vertices[i] = triangles[i];
  for (size_t i = 0; i < n * 3; i++) indices[i] = i;
  rtcCommitGeometry(mesh);
  rtcAttachGeometry(scene, mesh);
  double start = cpu();
  rtcCommitScene(scene);
  printf("%.6f\n", cpu() - start);
  fflush(stdout);
  std::vector<std::vector<float>> sets;
  for (int word = 3; word < count; word++) sets.push_back(floats(words[word]));
  for (size_t set; scanf("%zu", &set) == 1 && set < sets.size();) {
    auto& rays = sets[set];
    size_t m = rays.size() / 6, hits = 0;
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    double start = cpu();
    for (int pass = 0; pass < passes; pass++) {
      for (size_t i = 0; i < m; i++) {
        float* r = &rays[i * 6];
        RTCRayHit ray = {};
        ray.ray = {r[0], r[1], r[2], 0, r[3], r[4], r[5], 0, INFINITY, ~0u, 0, 0};
        ray.hit.geomID = ~0u;
        ray.hit.instID[0] = ~0u;
        rtcIntersect1(scene, &context, &ray);
        hits += ray.hit.geomID != ~0u;
      }
    }
    double middle = cpu();
    for (int pass = 0; pass < passes; pass++) {
      for (size_t i = 0; i < m; i++) {
        float* r = &rays[i * 6];
        RTCRay ray = {r[0], r[1], r[2], 0, r[3], r[4], r[5], 0, INFINITY, ~0u, 0, 0};
        rtcOccluded1(scene, &context, &ray);
      }
    }
    printf("%.9f %.9f %zu\n", middle - start, cpu() - middle, hits / passes);
    fflush(stdout);
  }
}
