// Tables, functions of one value: their names, their numbers, and the files these may stand in. All
// files that a deck names for its scene are part of what identifies it.
#include "deck.h"

#include "expression.h"

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <sstream>

namespace rk {

// Lines of a file at most; more are no table of a deck
constexpr int most_lines = 100000;

// Fields of a line: between semicolons, tabs or commas, whichever comes first in this order, or blanks
static std::vector<std::string> fields_of(const std::string &line) {
   char separator = ' ';
   for (const char candidate : {',', '\t', ';'}) {
      if (line.find(candidate) != std::string::npos)
         separator = candidate;
   }
   std::vector<std::string> fields;
   std::istringstream stream(line);
   if (separator == ' ') {
      for (std::string field; stream >> field;)
         fields.push_back(field);
      return fields;
   }
   for (std::string field; std::getline(stream, field, separator);) {
      const std::size_t from = field.find_first_not_of(" \t\r"), to = field.find_last_not_of(" \t\r");
      fields.push_back(from == std::string::npos ? "" : field.substr(from, to - from + 1));
   }
   return fields;
}

static std::optional<double> as_number(const std::string &field) {
   char *end = nullptr;
   const double number = std::strtod(field.c_str(), &end);
   if (end == field.c_str() || *end != '\0' || !std::isfinite(number))
      return std::nullopt;
   return number;
}

// Places and values of a file; "" or what is wrong with it, its name and line first
static std::string read_file(const std::string &text, const std::string &path,
                             std::vector<double> &x, std::vector<double> &value) {
   std::istringstream stream(text);
   int number = 0;
   bool titles = true;
   for (std::string line; std::getline(stream, line);) {
      const std::string place = path + ":" + std::to_string(++number) + ": ";
      const std::vector<std::string> fields = fields_of(line);
      if (fields.empty() || line.find_first_not_of(" \t\r") == std::string::npos || fields.front().rfind('#', 0) == 0)
         continue;
      if (number > most_lines)
         return place + "a table may have at most " + std::to_string(most_lines) + " lines";
      if (fields.size() < 2)
         return place + "has 1 column, 2 are needed";
      const std::optional<double> one = as_number(fields[0]), other = as_number(fields[1]);
      if (titles && !one && !other) {
         titles = false;
         continue;
      }
      titles = false;
      if (!one || !other)
         return place + quoted(one ? fields[1] : fields[0]) + " is not a finite number";
      if (!x.empty() && *one <= x.back())
         return place + "places must ascend: " + fields[0] + " follows " +
                Value(x.back()).plain();
      x.push_back(*one);
      value.push_back(*other);
   }
   return x.empty() ? path + ": has no numbers" : "";
}

// Bytes of a file that a deck names; nothing, and a complaint, where it cannot be read
static std::optional<std::string> bytes_of(Deck &deck, const Section &section, const std::string &key) {
   namespace fs = std::filesystem;
   const Value &file = *section.find(key);
   const std::string path = (fs::path(deck.folder) / file.text).string();
   std::error_code ignored;
   std::string why;
   std::optional<std::string> bytes = read_bytes(path, why);
   if (!bytes)
      deck.refuse(section, key,
                  quoted(file.text) + " cannot be read: " +
                     (fs::exists(path, ignored) ? why : "there is no such file in " + deck.folder));
   return bytes;
}

static void fill_from_file(Deck &deck, Section &table, const Value &file, std::string &contents) {
   const std::optional<std::string> text = bytes_of(deck, table, "file");
   if (!text)
      return;
   contents += "\n--table " + *text;
   std::vector<double> x, value;
   const std::string path = (std::filesystem::path(deck.folder) / file.text).string();
   const std::string fault = read_file(*text, path, x, value);
   if (!fault.empty()) {
      deck.refuse(table, "file", fault);
      return;
   }
   table.values["x"] = {x, file.origin};
   table.values["value"] = {value, file.origin};
}

void read_tables(Deck &deck) {
   std::string contents;
   const Section *geometry = deck.single("geometry");
   if (geometry && geometry->find("labels"))
      contents += "\n--labels " + bytes_of(deck, *geometry, "labels").value_or("");
   for (Section *table : deck.entries("table")) {
      const Value *name = table->find("name");
      const std::string fault = name ? table_name_fault(name->text) : "";
      if (!fault.empty())
         deck.refuse(*table, "name", fault);
      if (const Value *file = table->find("file"))
         fill_from_file(deck, *table, *file, contents);
   }
   if (contents.empty())
      return;
   deck.sha256 = sha256_hex(deck.sha256 + contents);
}

} // namespace rk
