// Opening a deck: the order of the steps, and the complaints.
#include "deck.h"

#include <algorithm>
#include <filesystem>
#include <limits>

namespace rk {

// Maximum number of complaints listed in a message
constexpr std::size_t most_complaints = 100;

const KeySpec *TableSpec::find(const std::string &key) const {
   for (const KeySpec &candidate : keys) {
      if (candidate.name == key)
         return &candidate;
   }
   return nullptr;
}

std::string TableSpec::title() const {
   if (name.empty())
      return "the top of the deck, before the first table";
   return many ? "[[" + name + "]]" : "[" + name + "]";
}

const Value *Section::find(const std::string &key) const {
   const auto found = values.find(key);
   return found == values.end() ? nullptr : &found->second;
}

bool Section::given(const std::string &key) const { return find(key) || refused.count(key); }

std::string Section::text(const std::string &key) const {
   const Value *value = find(key);
   return value && value->kind == Value::Kind::text ? value->text : "";
}

Deck::Deck(std::string name_in, std::string text_in, std::vector<std::string> overrides_in)
   : name(std::move(name_in)), text(std::move(text_in)), overrides(std::move(overrides_in)) {
   load();
   close();
}

Deck Deck::read(const std::string &path, std::vector<std::string> overrides) {
   namespace fs = std::filesystem;
   std::error_code ignored;
   std::string what;
   const std::optional<std::string> text = read_bytes(path, what);
   if (text)
      return Deck(path, *text, std::move(overrides));
   what = fs::is_directory(path, ignored) ? "is a folder; name the deck inside it" : "the deck cannot be read: " + what;
   Deck deck(path);
   deck.status = Status::file;
   deck.message = path + ": " + what;
   return deck;
}

std::string Deck::resolve(const std::string &key) {
   // a deck that could not be read has its own message
   if (sections.empty() && status != Status::good)
      return "";
   complaints_.clear();
   status = Status::good;
   const std::string found = full_key(*this, key);
   close();
   return found;
}

void Deck::require(const std::string &command) {
   if (status != Status::good)
      return;
   for (const TableSpec &spec : schema()) {
      const bool needed = is_one_of(command, spec.needed_by);
      // the table without a name is the top of the deck
      const bool replaced = !spec.not_beside.empty() && !entries(spec.not_beside).empty();
      if (needed && entries(spec.name).empty() && !replaced)
         complain({}, spec.name, "missing, " + command + " needs this table");
   }
   close();
}

// All steps; each continues after complaints, so that a user sees all of them at once
void Deck::load() {
   folder = std::filesystem::path(name).parent_path().string();
   if (folder.empty())
      folder = ".";
   std::string hashed = text;
   for (const std::string &item : overrides)
      hashed += "\n--set " + item;
   sha256 = sha256_hex(hashed);
   if (is_blank(text)) {
      complain({}, "", "the deck is empty");
      return;
   }
   if (!read_toml(*this))
      return;
   apply_overrides(*this);
   check_schema(*this);
   check_rules(*this);
}

void Deck::close() {
   std::stable_sort(complaints_.begin(), complaints_.end(),
                    [](const Complaint &a, const Complaint &b) { return a.order < b.order; });
   std::vector<std::string> lines;
   for (std::size_t i = 0; i < std::min(complaints_.size(), most_complaints); ++i)
      lines.push_back(complaints_[i].text);
   if (complaints_.size() > most_complaints)
      lines.push_back(name + ": and " + std::to_string(complaints_.size() - most_complaints) + " more");
   message = join(lines, "\n");
   if (!lines.empty())
      status = Status::input;
}

void Deck::complain(const Origin &origin, const std::string &address, const std::string &what) {
   const int order = origin.set.empty() ? origin.line : std::numeric_limits<int>::max();
   const std::string column = origin.column > 0 ? ":" + std::to_string(origin.column) : "";
   complaints_.push_back(
       {order, where(origin) + column + ": " + (address.empty() ? "" : shown(address) + ": ") + what});
}

void Deck::refuse(const Section &section, const std::string &key, const std::string &what) {
   const Value *value = section.find(key);
   complain(value ? value->origin : section.origin, address(section, key), what);
}

std::string Deck::where(const Origin &origin) const {
   return origin.set.empty() ? name + ":" + std::to_string(origin.line) : origin.set;
}

std::string Deck::address(const Section &section, const std::string &key) const {
   std::string all = section.spec->name;
   if (section.spec->many) {
      const std::string label =
          section.spec->named_by.empty() ? "" : section.text(section.spec->named_by);
      if (!is_blank(label)) {
         all += "." + label;
      } else if (const auto [first, last] = range_of(*section.spec); last - first > 1) {
         all += "." + std::to_string(section.index);
      }
   }
   if (key.empty())
      return all;
   return all.empty() ? key : all + "." + key;
}

const TableSpec *find_table(const std::string &name) {
   for (const TableSpec &spec : schema()) {
      if (spec.name == name)
         return &spec;
   }
   return nullptr;
}

std::vector<std::string> table_names() {
   std::vector<std::string> names;
   for (const TableSpec &spec : schema()) {
      if (!spec.name.empty())
         names.push_back(spec.name);
   }
   return names;
}

std::pair<std::size_t, std::size_t> Deck::range_of(const TableSpec &spec) const {
   const auto first = std::lower_bound(
       sections.begin(), sections.end(), &spec,
       [](const Section &section, const TableSpec *wanted) { return section.spec < wanted; });
   const auto last = std::upper_bound(
       first, sections.end(), &spec,
       [](const TableSpec *wanted, const Section &section) { return wanted < section.spec; });
   return {first - sections.begin(), last - sections.begin()};
}

const Section *Deck::single(const std::string &table) const {
   const TableSpec *spec = find_table(table);
   if (!spec || spec->many)
      return nullptr;
   const auto [first, last] = range_of(*spec);
   return first < last ? &sections[first] : nullptr;
}

const Value *Deck::value(const std::string &table, const std::string &key) const {
   const Section *section = single(table);
   return section ? section->find(key) : nullptr;
}

std::string Deck::word(const std::string &table, const std::string &key) const {
   const Section *section = single(table);
   return section ? section->text(key) : "";
}

int Deck::dimension() const {
   const Value *given = value("scene", "dimension");
   return given ? static_cast<int>(given->integer) : 0;
}

std::vector<Section *> Deck::entries(const std::string &table) {
   std::vector<Section *> found;
   if (const TableSpec *spec = find_table(table)) {
      const auto [first, last] = range_of(*spec);
      for (std::size_t i = first; i < last; ++i)
         found.push_back(&sections[i]);
   }
   return found;
}

Section &Deck::add(const TableSpec &spec, const Origin &origin) {
   Section section;
   section.spec = &spec;
   section.origin = origin;
   return *sections.insert(sections.begin() + static_cast<std::ptrdiff_t>(range_of(spec).second), section);
}

std::string Deck::lookup(const Section &section, const std::string &key) const {
   const auto fact = facts.find(key);
   if (fact != facts.end())
      return fact->second;
   const std::size_t dot = key.find('.');
   const Value *found =
       dot == std::string::npos ? section.find(key) : value(key.substr(0, dot), key.substr(dot + 1));
   return found ? found->plain() : "";
}

} // namespace rk
