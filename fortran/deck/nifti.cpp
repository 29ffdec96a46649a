// Label maps in NIfTI files (.nii, .nii.gz), read by niftilib and placed as imaging/nifti.py does.
#include "label_map.h"

#include <algorithm>
#include <limits>
#include <map>
#include <memory>

#include <nifti2_io.h>

namespace rk {

// Voxels of a map at most: more are a damaged header
constexpr std::int64_t most_voxels = 1'000'000'000;

namespace {

struct Free {
   void operator()(nifti_image *image) const { nifti_image_free(image); }
};
using File = std::unique_ptr<nifti_image, Free>;

// Affine of a file [mm]: sform, else qform, else the voxel sizes with the middle at 0 and x turned
void place(const nifti_image &image, LabelMap &map) {
   const bool none = image.sform_code <= 0 && image.qform_code <= 0;
   const auto &matrix = image.sform_code > 0 ? image.sto_xyz.m : image.qto_xyz.m;
   const double size[] = {-image.dx, image.dy, image.dz};
   const double factor = image.xyz_units == NIFTI_UNITS_METER    ? 1000.0
                         : image.xyz_units == NIFTI_UNITS_MICRON ? 0.001
                                                                 : 1.0;
   for (std::size_t d = 0; d < 3; ++d) {
      for (std::size_t c = 0; c < 3; ++c)
         map.column[c][d] = factor * (none ? (c == d ? size[d] : 0.0) : matrix[d][c]);
      map.first[d] = none ? -0.5 * map.column[d][d] * (map.shape[d] - 1) : factor * matrix[d][3];
   }
}

// Values as labels; what is wrong with one, or ""
template <typename T> std::string take(const nifti_image &image, LabelMap &map) {
   const T *value = static_cast<const T *>(image.data);
   map.label.resize(static_cast<std::size_t>(image.nvox));
   for (std::int32_t &label : map.label) {
      const T stored = *value++;
      const double here = static_cast<double>(stored);
      if (!(here >= 0.0 && here <= std::numeric_limits<std::int32_t>::max()))
         return "has the label " + std::to_string(stored) + "; labels are from 0 to 2147483647";
      label = static_cast<std::int32_t>(here);
      if (here != static_cast<double>(label))
         return "has the value " + std::to_string(stored) + "; labels are whole numbers";
   }
   return "";
}

// Readers of the types that a label map may have
const std::map<int, std::string (*)(const nifti_image &, LabelMap &)> readers = {
   {DT_UINT8, take<std::uint8_t>},   {DT_INT8, take<std::int8_t>},     {DT_INT16, take<std::int16_t>},
   {DT_UINT16, take<std::uint16_t>}, {DT_INT32, take<std::int32_t>},   {DT_UINT32, take<std::uint32_t>},
   {DT_INT64, take<std::int64_t>},   {DT_UINT64, take<std::uint64_t>}, {DT_FLOAT32, take<float>},
   {DT_FLOAT64, take<double>}};

// What no label map has, by the header alone; or ""
std::string header_fault(const nifti_image &image) {
   const std::int64_t size[] = {image.nx, image.ny, image.nz};
   for (const std::int64_t n : size) {
      if (n < 1 || n > most_voxels)
         return "is not a readable NIfTI file: it has " + std::to_string(n) + " voxels along an axis";
   }
   if (image.nvox > most_voxels)
      return "is not a readable NIfTI file: more than 1e9 voxels";
   if (image.nvox != image.nx * image.ny * image.nz)
      return "is not a label map: it has " + std::to_string(image.nvox / (image.nx * image.ny * image.nz)) +
             " values per voxel; extract one of them";
   if (readers.count(image.datatype) == 0)
      return std::string("holds values of type ") + nifti_datatype_string(image.datatype) +
             "; save the label map with an integer data type";
   if ((image.scl_slope != 0.0 && image.scl_slope != 1.0) || image.scl_inter != 0.0)
      return "scales its values (scl_slope, scl_inter); save the label map without scaling";
   return "";
}

} // namespace

std::string read_nifti(const std::string &path, LabelMap &map) {
   nifti_set_debug_level(0); // it prints more than the worst errors otherwise
   const File file(nifti_image_read(path.c_str(), 0));
   if (!file)
      return "is not a readable NIfTI file; a label map is one (.nii, .nii.gz)";
   const std::string fault = header_fault(*file);
   if (!fault.empty())
      return fault;
   map.shape = {static_cast<int>(file->nx), static_cast<int>(file->ny), static_cast<int>(file->nz)};
   if (nifti_image_load(file.get()) != 0 || !file->data)
      return "ends before the values that its header promises";
   place(*file, map);
   return readers.at(file->datatype)(*file, map);
}

} // namespace rk
