// Texts of messages, and the hash that identifies a deck.
#include "deck.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <sstream>

#include <openssl/sha.h>

namespace rk {

std::string join(const std::vector<std::string> &words, const char *separator) {
   std::string all;
   for (const std::string &word : words)
      all += (all.empty() ? "" : separator) + word;
   return all;
}

bool is_blank(const std::string &text) {
   // the last three are a byte order mark
   return text.find_first_not_of(" \t\r\n\xef\xbb\xbf") == std::string::npos;
}

bool is_one_of(const std::string &word, const std::vector<std::string> &list) {
   return std::find(list.begin(), list.end(), word) != list.end();
}

std::string escaped(const std::string &text) {
   std::string clean;
   for (const char letter : text) {
      std::array<char, 8> code{};
      const bool control = static_cast<unsigned char>(letter) < 32 || letter == 127;
      std::snprintf(code.data(), code.size(), control ? "\\u%04x" : "%c", letter);
      clean += code.data();
   }
   return clean;
}

std::string shown(const std::string &word) {
   constexpr std::size_t longest = 200;
   std::size_t end = std::min(word.size(), longest);
   // do not cut within a character of UTF-8
   while (end < word.size() && end > 0 && (static_cast<unsigned char>(word[end]) & 0xc0) == 0x80)
      --end;
   return escaped(word.substr(0, end)) + (end < word.size() ? "..." : "");
}

std::string exactly(double number) {
   std::array<char, 32> digits{};
   return {digits.data(), std::to_chars(digits.data(), digits.data() + digits.size(), number).ptr};
}

std::string quoted(const std::string &word) {
   return "'" + shown(word) + "'";
}

// Number of inserted, removed, changed or swapped letters between two words, case ignored
static std::size_t distance(const std::string &a, const std::string &b) {
   std::vector<std::vector<std::size_t>> d(a.size() + 1, std::vector<std::size_t>(b.size() + 1));
   auto lower = [](char c) { return c >= 'A' && c <= 'Z' ? char(c + 32) : c; };
   for (std::size_t i = 0; i <= a.size(); ++i) {
      for (std::size_t j = 0; j <= b.size(); ++j) {
         if (i == 0 || j == 0) {
            d[i][j] = i + j;
            continue;
         }
         const bool same = lower(a[i - 1]) == lower(b[j - 1]);
         d[i][j] = std::min({d[i - 1][j] + 1, d[i][j - 1] + 1, d[i - 1][j - 1] + (same ? 0 : 1)});
         if (i > 1 && j > 1 && lower(a[i - 1]) == lower(b[j - 2]) &&
             lower(a[i - 2]) == lower(b[j - 1]))
            d[i][j] = std::min(d[i][j], d[i - 2][j - 2] + 1);
      }
   }
   return d[a.size()][b.size()];
}

std::string suggest(const std::string &word, const std::vector<std::string> &known,
                    const std::string &otherwise) {
   // a word much longer than all known ones resembles none of them
   constexpr std::size_t longest = 200;
   std::vector<std::string> best;
   std::size_t nearest = word.size() < 2 ? 0 : std::max<std::size_t>(1, word.size() / 3);
   for (const std::string &candidate : known) {
      const bool begins = word.size() > 2 && candidate.compare(0, word.size(), word) == 0;
      const std::size_t steps = begins                  ? 1
                                : word.size() > longest ? word.size()
                                                        : distance(word, candidate);
      if (steps > nearest)
         continue;
      if (steps < nearest)
         best.clear();
      nearest = steps;
      best.push_back(quoted(candidate));
   }
   if (!best.empty() && best.size() < 4)
      return "; did you mean " + join(best, " or ") + "?";
   if (otherwise.empty() || known.empty())
      return "";
   // a deck may have many names
   constexpr std::size_t most = 100;
   if (known.size() > most)
      return "; " + otherwise + " " + join({known.begin(), known.begin() + most}, ", ") + " and " +
             std::to_string(known.size() - most) + " more";
   return "; " + otherwise + " " + join(known, ", ");
}

std::string unknown_table(const std::string &name) {
   return "unknown table" + suggest(name, table_names(), "known tables are:");
}

std::string unknown_key(const TableSpec &table, const std::string &key) {
   std::vector<std::string> known;
   for (const KeySpec &spec : table.keys)
      known.push_back(spec.name);
   for (const TableSpec &other : schema()) {
      if (&other != &table && other.find(key))
         return "unknown key; " + quoted(key) + " belongs to " + other.title();
   }
   return "unknown key" + suggest(key, known, "known keys are:");
}

std::optional<std::string> read_bytes(const std::string &path, std::string &why) {
   std::error_code ignored;
   // opening a pipe would wait for its other end
   if (std::filesystem::exists(path, ignored) && !std::filesystem::is_regular_file(path, ignored)) {
      why = "it is not a regular file";
      return std::nullopt;
   }
   std::ifstream file(path, std::ios::binary);
   if (!file) {
      why = std::strerror(errno);
      return std::nullopt;
   }
   std::ostringstream text;
   text << file.rdbuf();
   return text.str();
}

std::string Value::plain() const {
   switch (kind) {
   case Kind::text:
      return text;
   case Kind::integer:
      return std::to_string(integer);
   case Kind::real: {
      std::array<char, 32> buffer{};
      const bool whole = std::abs(real) < 1e9 && real == std::floor(real);
      std::snprintf(buffer.data(), buffer.size(), whole ? "%.0f" : "%.6g", real);
      return buffer.data();
   }
   case Kind::boolean:
      return boolean ? "true" : "false";
   case Kind::array: {
      std::vector<std::string> parts;
      for (const Value &item : items)
         parts.push_back(item.plain());
      return "[" + join(parts, ", ") + "]";
   }
   default:
      return kind_name();
   }
}

const char *Value::kind_name() const {
   switch (kind) {
   case Kind::text:
      return "a text";
   case Kind::integer:
      return "an integer";
   case Kind::real:
      return "a real number";
   case Kind::boolean:
      return "true or false";
   case Kind::date:
      return "a date or time";
   case Kind::array:
      return "an array";
   default:
      return "a table";
   }
}

std::string Value::described() const {
   switch (kind) {
   case Kind::text:
      return "the text " + quoted(text);
   case Kind::array:
      return std::string(kind_name()) + " of " + std::to_string(items.size());
   case Kind::date:
   case Kind::table:
      return kind_name();
   case Kind::real:
      // 3.0 must not look like an integer
      return plain().find_first_not_of("-0123456789") == std::string::npos ? plain() + ".0"
                                                                           : plain();
   default:
      return plain();
   }
}

std::string sha256_hex(const std::string &bytes) {
   std::array<unsigned char, SHA256_DIGEST_LENGTH> digest{};
   SHA256(reinterpret_cast<const unsigned char *>(bytes.data()), bytes.size(), digest.data());
   std::string hex;
   for (const unsigned char byte : digest) {
      std::array<char, 3> part{};
      std::snprintf(part.data(), part.size(), "%02x", byte);
      hex += part.data();
   }
   return hex;
}

} // namespace rk
