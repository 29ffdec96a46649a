// Label maps laid over a box, whose labels expressions ask for.
#include "label_map.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <map>
#include <mutex>
#include <sstream>

namespace rk {

// Part of a voxel by which a header in single precision may be off: a border belongs to the voxel
// beyond it, seen from the origin, and a box may be so much larger than the map
constexpr double slack = 1e-3;

namespace {

// A map over a box, in the coordinates of the box
struct Laid {
   std::array<int, 3> shape{};
   std::vector<std::int32_t> label;
   std::array<Place, 3> row{}; // of the matrix from places to voxel indices
   Place shift{};
   Place last{};                // what lies beyond belongs to the voxels before it
   std::map<int, Place> in_box; // labels with the middle of their first voxel

   Place index(const Place &x) const {
      Place v = shift;
      for (std::size_t i = 0; i < 3; ++i) {
         for (std::size_t d = 0; d < 3; ++d)
            v[i] += row[i][d] * x[d];
      }
      return v;
   }

   std::size_t voxel(const Place &v) const {
      std::array<int, 3> at{};
      for (std::size_t i = 0; i < 3; ++i) {
         const double beyond = row[i][0] + row[i][1] + row[i][2] < 0.0 ? -slack : slack;
         at[i] = std::clamp(static_cast<int>(std::floor(v[i] + 0.5 + beyond)), 0, shape[i] - 1);
      }
      return static_cast<std::size_t>(at[0]) +
             static_cast<std::size_t>(shape[0]) *
                (static_cast<std::size_t>(at[1]) +
                 static_cast<std::size_t>(shape[1]) * static_cast<std::size_t>(at[2]));
   }

   bool operator==(const Laid &other) const {
      return shape == other.shape && label == other.label && row == other.row && shift == other.shift &&
             last == other.last;
   }
};

// All that were ever used, equal ones once, so that a number stands for a map
std::mutex maps_door;
std::deque<Laid> all_maps;

const Laid &laid(double number) {
   const std::lock_guard<std::mutex> here(maps_door);
   return all_maps.at(static_cast<std::size_t>(number));
}

std::string told(const Place &x, int nd) {
   std::ostringstream text;
   for (int d = 0; d < nd; ++d)
      text << (d == 0 ? "(" : ", ") << x[static_cast<std::size_t>(d)];
   return text.str() + ")";
}

// The lowest corner of what the map fills [mm]
Place lowest(const LabelMap &map) {
   Place low = map.first;
   for (std::size_t d = 0; d < 3; ++d) {
      for (std::size_t k = 0; k < 3; ++k)
         low[d] += std::min(-0.5 * map.column[k][d], (map.shape[k] - 0.5) * map.column[k][d]);
   }
   return low;
}

// Rows from world coordinates [mm] to voxel indices; whether there are any
bool invert(const std::array<Place, 3> &c, std::array<Place, 3> &row) {
   const auto cross = [](const Place &a, const Place &b) {
      return Place{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
   };
   row = {cross(c[1], c[2]), cross(c[2], c[0]), cross(c[0], c[1])};
   const double volume = c[0][0] * row[0][0] + c[0][1] * row[0][1] + c[0][2] * row[0][2];
   if (!(std::abs(volume) > 0.0) || !std::isfinite(volume))
      return false;
   for (Place &r : row) {
      for (double &item : r)
         item /= volume;
   }
   return true;
}

// Which labels the box holds: those of voxels that share more than a border with it
void look_around(const LabelMap &map, const Place &size, Laid &over, double factor, const Place &origin) {
   Place reach{};
   for (std::size_t d = 0; d < 3; ++d) {
      for (std::size_t k = 0; k < 3; ++k)
         reach[d] += 0.5 * factor * std::abs(map.column[k][d]);
      over.last[d] = std::max(0.0, size[d] - 4.0 * slack * reach[d]);
   }
   std::size_t at = 0;
   int known = -1;
   for (int k = 0; k < over.shape[2]; ++k) {
      for (int j = 0; j < over.shape[1]; ++j) {
         for (int i = 0; i < over.shape[0]; ++i, ++at) {
            if (over.label[at] == known)
               continue;
            bool inside = true;
            Place x;
            for (std::size_t d = 0; d < 3; ++d) {
               const double margin = slack * reach[d];
               x[d] = factor * (map.first[d] + map.column[0][d] * i + map.column[1][d] * j +
                                map.column[2][d] * k) - origin[d];
               inside = inside && x[d] + reach[d] > margin &&
                        x[d] - reach[d] < (size[d] > 0.0 ? size[d] - margin : margin);
            }
            if (!inside)
               continue;
            known = over.label[at];
            over.in_box.emplace(known, x);
         }
      }
   }
}

// Lay a map over a box; what is wrong, or ""
std::string lay(const LabelMap &map, double factor, const double *begin, const double *extent, int nd, Laid &over) {
   over.shape = map.shape;
   over.label = map.label;
   if (!invert(map.column, over.row))
      return "has a singular affine: set sform or qform of the file from the scanner's geometry";
   Place origin = lowest(map), size{};
   for (std::size_t d = 0; d < 3; ++d) {
      origin[d] = std::isnan(begin[d]) ? factor * origin[d] : begin[d];
      size[d] = static_cast<int>(d) < nd ? extent[d] : 0.0;
   }
   if (nd == 2 && std::isnan(begin[2])) {
      if (map.shape[2] > 1)
         return "has " + std::to_string(map.shape[2]) + " slices: say with labels_origin at which height " +
                "the plane lies, its third number";
      origin[2] = factor * map.first[2];
   }
   for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t d = 0; d < 3; ++d) {
         over.shift[i] += over.row[i][d] * (origin[d] / factor - map.first[d]);
         over.row[i][d] /= factor;
      }
   }
   for (int corner = 0; corner < 8; ++corner) {
      Place x;
      for (std::size_t d = 0; d < 3; ++d)
         x[d] = (corner >> d) & 1 ? size[d] : 0.0;
      const Place v = over.index(x);
      for (std::size_t i = 0; i < 3; ++i) {
         if (v[i] >= -0.5 - slack && v[i] <= over.shape[i] - 0.5 + slack)
            continue;
         return "does not cover the box: the corner " + told(x, nd) + " lies at voxel " + told(v, 3) +
                ", and the map has " + std::to_string(over.shape[0]) + " x " +
                std::to_string(over.shape[1]) + " x " + std::to_string(over.shape[2]) +
                "; make the box smaller, or say with labels_origin where in the map it begins";
      }
   }
   look_around(map, size, over, factor, origin);
   return "";
}

} // namespace

double label_at(double number, double x, double y, double z) {
   const Laid &map = laid(number);
   const rk::Place &last = map.last;
   return map.label[map.voxel(map.index({std::min(x, last[0]), std::min(y, last[1]), std::min(z, last[2])}))];
}

} // namespace rk

extern "C" {

// Number of the label map of a file, laid over a box; -1, and what is wrong in `fault`
int rk_label_map_open(const char *path, double factor, const double *origin, const double *size,
                      int nd, const char **fault) {
   thread_local std::string what;
   rk::LabelMap map;
   rk::Laid over;
   what = rk::read_nifti(path, map);
   if (what.empty())
      what = rk::lay(map, factor, origin, size, nd, over);
   *fault = what.c_str();
   if (!what.empty())
      return -1;
   const std::lock_guard<std::mutex> here(rk::maps_door);
   const auto found = std::find(rk::all_maps.begin(), rk::all_maps.end(), over);
   const auto number = static_cast<int>(found - rk::all_maps.begin());
   if (found == rk::all_maps.end())
      rk::all_maps.push_back(std::move(over));
   return number;
}

// Label of that number, in their order, and a place where it is; -1 where the box has no more
int rk_label_map_label(int number, int which, double *place) {
   const rk::Laid &map = rk::laid(number);
   if (which >= static_cast<int>(map.in_box.size()))
      return -1;
   const auto found = std::next(map.in_box.begin(), which);
   std::copy(found->second.begin(), found->second.end(), place);
   return found->first;
}

} // extern "C"
