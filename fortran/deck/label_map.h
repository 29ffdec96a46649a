// Label maps: images of whole numbers that say what lies where.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace rk {

using Place = std::array<double, 3>;

// A label map as its file has it
struct LabelMap {
   std::array<int, 3> shape{};
   std::vector<std::int32_t> label; // the first index runs fastest
   // Voxel indices, whole at the middles of voxels, to world coordinates [mm]
   std::array<Place, 3> column{};
   Place first{};
};

// label_map.cpp: label at a place of the box over which map `number` was laid
double label_at(double number, double x, double y, double z);

// nifti.cpp: read a file; what is wrong with it, or ""
std::string read_nifti(const std::string &path, LabelMap &map);

} // namespace rk
