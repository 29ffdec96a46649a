// Label maps in NIfTI files (.nii, .nii.gz), as imaging/nifti.py reads them.
#include "label_map.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>

#include <zlib.h>

namespace rk {

// Bytes of a header, and the voxels of a map at most: more are a damaged header
constexpr int header_bytes = 348;
constexpr double most_voxels = 1e9;

namespace {

struct Closing {
   void operator()(gzFile file) const { gzclose(file); }
};
using File = std::unique_ptr<gzFile_s, Closing>;

// Numbers of a header or of voxels, in the order of bytes of the file
struct Bytes {
   std::vector<unsigned char> all;
   bool turned = false;

   template <typename T> T at(std::size_t place) const {
      unsigned char part[sizeof(T)];
      std::copy_n(all.begin() + static_cast<std::ptrdiff_t>(place), sizeof(T), part);
      if (turned)
         std::reverse(part, part + sizeof(T));
      T value;
      std::memcpy(&value, part, sizeof(T));
      return value;
   }
};

// As much as is wanted; whether it was there
bool fill(gzFile file, std::vector<unsigned char> &bytes, std::size_t wanted) {
   constexpr std::size_t piece = 1u << 24; // a header that lies asks for no memory
   bytes.clear();
   while (bytes.size() < wanted) {
      const std::size_t had = bytes.size(), more = std::min(piece, wanted - had);
      bytes.resize(had + more);
      const int got = gzread(file, bytes.data() + had, static_cast<unsigned>(more));
      if (got < 0 || static_cast<std::size_t>(got) != more)
         return false;
   }
   return true;
}

// Bytes of a voxel; 0 for values that are no whole numbers
int width_of(int kind) {
   switch (kind) {
   case 2:   // uint8
   case 256: // int8
      return 1;
   case 4:   // int16
   case 512: // uint16
      return 2;
   case 8:   // int32
   case 768: // uint32
      return 4;
   case 1024: // int64
   case 1280: // uint64
      return 8;
   default:
      return 0;
   }
}

double voxel(const Bytes &bytes, int kind, std::size_t i) {
   switch (kind) {
   case 2:
      return bytes.at<std::uint8_t>(i);
   case 256:
      return bytes.at<std::int8_t>(i);
   case 4:
      return bytes.at<std::int16_t>(2 * i);
   case 512:
      return bytes.at<std::uint16_t>(2 * i);
   case 8:
      return bytes.at<std::int32_t>(4 * i);
   case 768:
      return bytes.at<std::uint32_t>(4 * i);
   case 1024:
      return static_cast<double>(bytes.at<std::int64_t>(8 * i));
   default:
      return static_cast<double>(bytes.at<std::uint64_t>(8 * i));
   }
}

// Affine of a header [mm]: sform, else qform, else the voxel sizes with the middle at 0 and x turned
void place(const Bytes &header, LabelMap &map) {
   const auto number = [&](int at) { return static_cast<double>(header.at<float>(static_cast<std::size_t>(at))); };
   const std::array<double, 3> size = {number(80), number(84), number(88)};
   if (header.at<std::int16_t>(254) > 0) {
      for (std::size_t d = 0; d < 3; ++d) {
         const int row = 280 + 16 * static_cast<int>(d);
         for (std::size_t c = 0; c < 3; ++c)
            map.column[c][d] = number(row + 4 * static_cast<int>(c));
         map.first[d] = number(row + 12);
      }
   } else if (header.at<std::int16_t>(252) > 0) {
      const double b = number(256), c = number(260), d = number(264);
      const double a = std::sqrt(std::max(0.0, 1.0 - b * b - c * c - d * d));
      const double last = number(76) < 0.0 ? -size[2] : size[2];
      map.column[0] = {a * a + b * b - c * c - d * d, 2 * (b * c + a * d), 2 * (b * d - a * c)};
      map.column[1] = {2 * (b * c - a * d), a * a + c * c - b * b - d * d, 2 * (c * d + a * b)};
      map.column[2] = {2 * (b * d + a * c), 2 * (c * d - a * b), a * a + d * d - b * b - c * c};
      const std::array<double, 3> length = {size[0], size[1], last};
      for (std::size_t k = 0; k < 3; ++k) {
         for (double &item : map.column[k])
            item *= length[k];
         map.first[k] = number(268 + 4 * static_cast<int>(k));
      }
   } else {
      for (std::size_t k = 0; k < 3; ++k) {
         map.column[k] = {};
         map.column[k][k] = k == 0 ? -size[k] : size[k];
         map.first[k] = -0.5 * map.column[k][k] * (map.shape[k] - 1);
      }
   }
   const int unit = header.at<std::uint8_t>(123) & 7;
   const double factor = unit == 1 ? 1000.0 : unit == 3 ? 0.001 : 1.0;
   for (Place &column : map.column) {
      for (double &item : column)
         item *= factor;
   }
   for (double &item : map.first)
      item *= factor;
}

std::string shape_fault(const Bytes &header, LabelMap &map) {
   const int dimensions = header.at<std::int16_t>(40);
   double all = 1.0;
   if (dimensions < 2 || dimensions > 7)
      return "is no readable NIfTI file: it has " + std::to_string(dimensions) + " dimensions";
   for (int k = 0; k < dimensions; ++k) {
      const int n = header.at<std::int16_t>(static_cast<std::size_t>(42 + 2 * k));
      if (n < 1)
         return "is no readable NIfTI file: it has " + std::to_string(n) + " voxels along an axis";
      if (k > 2 && n > 1)
         return "is no label map: it has " + std::to_string(n) + " values a voxel; extract one of them";
      if (k < 3)
         map.shape[static_cast<std::size_t>(k)] = n;
      all *= n;
   }
   if (dimensions == 2)
      map.shape[2] = 1;
   return all > most_voxels ? "is no readable NIfTI file: more than 1e9 voxels" : "";
}

} // namespace

std::string read_nifti(const std::string &path, LabelMap &map) {
   const File file(gzopen(path.c_str(), "rb"));
   Bytes header;
   if (!file)
      return "cannot be read";
   const bool whole = fill(file.get(), header.all, header_bytes);
   const auto has_length = [&](std::int32_t length) {
      for (const bool turned : {true, false}) {
         header.turned = turned;
         if (whole && header.at<std::int32_t>(0) == length)
            return true;
      }
      return false;
   };
   if (has_length(540))
      return "is NIfTI of version 2; save it as version 1";
   if (!has_length(header_bytes) || std::memcmp(header.all.data() + 344, "n+1", 3) != 0)
      return "is no NIfTI file with header and values in one; a label map is one (.nii, .nii.gz)";
   const std::string fault = shape_fault(header, map);
   if (!fault.empty())
      return fault;
   const int kind = header.at<std::int16_t>(70), width = width_of(kind);
   if (width == 0)
      return "holds values of NIfTI's type " + std::to_string(kind) +
             ", which are no whole numbers; save the label map with an integer data type";
   const auto start = static_cast<z_off_t>(header.at<float>(108));
   if (start < header_bytes || gzseek(file.get(), start, SEEK_SET) != start)
      return "is no readable NIfTI file: its values start at byte " + std::to_string(start);
   const std::size_t count = static_cast<std::size_t>(map.shape[0]) *
                             static_cast<std::size_t>(map.shape[1]) *
                             static_cast<std::size_t>(map.shape[2]);
   Bytes values;
   values.turned = header.turned;
   if (!fill(file.get(), values.all, count * static_cast<std::size_t>(width)))
      return "ends before the values that its header promises";
   map.label.resize(count);
   for (std::size_t i = 0; i < count; ++i) {
      const double value = voxel(values, kind, i);
      if (value < 0.0 || value > 2147483647.0)
         return "has the label " + std::to_string(static_cast<long long>(value)) +
                "; labels are from 0 to 2147483647";
      map.label[i] = static_cast<std::int32_t>(value);
   }
   place(header, map);
   return "";
}

} // namespace rk
