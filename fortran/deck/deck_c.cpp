// Decks for rk_deck.f90: a view of the deck with a flat list of entries, in the order of their
// keys, and its values as JSON.
//
// Texts are one per line, booleans in JSON only. A text that names an entry of another table comes
// with the number of that entry, from 1, an array of tables with the number of its entries. All
// pointers are valid until rk_deck_close.
#include "deck.h"

#include <cmath>
#include <sstream>

extern "C" {

// The same as entry_view and deck_view in rk_deck.f90
struct EntryView {
   const char *key, *where, *address, *text;
   const double *numbers;
   int count, kind;
};

struct DeckView {
   const char *message, *name, *text, *sha256, *folder, *json, *full_key;
   const EntryView *entries;
   int count, status;
};

} // extern "C"

namespace {

enum Kind { other, is_text, is_list };

struct Entry {
   std::string where, address, text;
   int kind = other;
   std::vector<double> numbers;
};

struct Flat : DeckView {
   rk::Deck deck;
   std::string full_key, json;
   std::map<std::string, Entry> entries;
   std::map<std::string, std::map<std::string, int>> numbers; // of entries, by table and name
   std::vector<EntryView> views;
};

Entry flatten(const rk::Value &value) {
   Entry entry;
   if (value.is_number())
      entry.numbers = {value.number()};
   if (value.kind == rk::Value::Kind::text) {
      entry.kind = is_text;
      entry.text = value.text;
   }
   for (const rk::Value &item : value.items) {
      if (item.is_number())
         entry.numbers.push_back(item.number());
      else
         entry.text += item.text + "\n";
   }
   return entry;
}

std::string prefix_of(const rk::Section &section) {
   return section.spec->name + (section.spec->many ? "." + std::to_string(section.index) : "");
}

void add_section(Flat &flat, const rk::Section &section) {
   const std::string prefix = prefix_of(section);
   if (!prefix.empty()) {
      Entry &table = flat.entries[prefix];
      table.where = flat.deck.where(section.origin);
      table.address = flat.deck.address(section);
   }
   for (const rk::KeySpec &spec : section.spec->keys) {
      const rk::Value *value = section.find(spec.name);
      if (!value)
         continue;
      Entry &entry = flat.entries[prefix.empty() ? spec.name : prefix + "." + spec.name];
      entry = flatten(*value);
      if (!spec.refers_to.empty())
         entry.numbers = {static_cast<double>(flat.numbers[spec.refers_to][value->text])};
      // empty for a default
      entry.where = value->by_default ? "" : flat.deck.where(value->origin);
      entry.address = flat.deck.address(section, spec.name);
   }
}

// A text with JSON's escapes
std::string json_text(const std::string &text) {
   std::string all;
   for (const char letter : text) {
      if (letter == '"' || letter == '\\')
         all += '\\';
      all += letter;
   }
   return "\"" + rk::escaped(all) + "\"";
}

// A number that reads back the same, with a point unless it is an integer
std::string json_number(const rk::Value &value, rk::Type type) {
   if (type == rk::Type::integer || type == rk::Type::integers)
      return std::to_string(value.integer);
   // JSON has no infinity: use the word of the deck
   if (!std::isfinite(value.number()))
      return "\"inf\"";
   const std::string text = rk::exactly(value.number());
   return text.find_first_of(".e") == std::string::npos ? text + ".0" : text;
}

std::string json_of(const rk::Value &value, rk::Type type) {
   if (value.kind == rk::Value::Kind::array) {
      std::vector<std::string> items;
      for (const rk::Value &item : value.items)
         items.push_back(json_of(item, type));
      return "[" + rk::join(items, ", ") + "]";
   }
   if (value.is_number())
      return json_number(value, type);
   return value.kind == rk::Value::Kind::text ? json_text(value.text) : value.plain();
}

// Keys and values of a section, with commas between
std::string json_of(const rk::Section &section) {
   std::vector<std::string> pairs;
   for (const rk::KeySpec &spec : section.spec->keys) {
      if (const rk::Value *value = section.find(spec.name))
         pairs.push_back("\"" + spec.name + "\": " + json_of(*value, spec.type));
   }
   return rk::join(pairs, ", ");
}

void fill(Flat &flat) {
   for (const rk::Section &section : flat.deck.sections) {
      if (!section.spec->named_by.empty())
         flat.numbers[section.spec->name][section.text(section.spec->named_by)] = section.index;
   }
   std::vector<std::string> tables;
   for (const rk::TableSpec &spec : rk::schema()) {
      // a refused deck has no values
      if (flat.deck.status != rk::Status::good)
         break;
      const std::vector<rk::Section *> sections = flat.deck.entries(spec.name);
      std::vector<std::string> objects;
      for (const rk::Section *section : sections) {
         add_section(flat, *section);
         objects.push_back(spec.name.empty() ? json_of(*section) : "{" + json_of(*section) + "}");
      }
      const std::string all = rk::join(objects, ",\n   ");
      if (spec.many) {
         Entry &list = flat.entries[spec.name];
         list.where = flat.deck.where(sections.empty() ? rk::Origin{} : sections.front()->origin);
         list.kind = is_list;
         list.numbers = {static_cast<double>(sections.size())};
         tables.push_back("\"" + spec.name + "\": [" + all + "]");
      } else if (!all.empty()) {
         tables.push_back(spec.name.empty() ? all : "\"" + spec.name + "\": " + all);
      }
   }
   flat.json = "{" + rk::join(tables, ",\n  ") + "}";
   for (const auto &[key, entry] : flat.entries)
      flat.views.push_back({key.c_str(), entry.where.c_str(), entry.address.c_str(), entry.text.c_str(),
                            entry.numbers.data(), static_cast<int>(entry.numbers.size()), entry.kind});
   const rk::Deck &deck = flat.deck;
   static_cast<DeckView &>(flat) = {
      deck.message.c_str(), deck.name.c_str(), deck.text.c_str(), deck.sha256.c_str(), deck.folder.c_str(),
      flat.json.c_str(), flat.full_key.c_str(), flat.views.data(), static_cast<int>(flat.views.size()),
      static_cast<int>(deck.status)};
}

// Overrides, one per line
std::vector<std::string> lines(const char *text) {
   std::vector<std::string> found;
   std::istringstream stream(text);
   for (std::string line; std::getline(stream, line);) {
      if (!line.empty())
         found.push_back(line);
   }
   return found;
}

} // namespace

extern "C" {

// Read and check a file, or a text if given, for a command ("" for none). With a key, status and
// message are those of its full name, as in an override
DeckView *rk_deck_open(const char *path, const char *text, const char *overrides, const char *command,
                       const char *key) {
   rk::Deck deck = rk::is_blank(text) ? rk::Deck::read(path, lines(overrides))
                                      : rk::Deck(path, text, lines(overrides));
   deck.require(command);
   const std::string full_key = *key ? deck.resolve(key) : "";
   Flat *flat = new Flat{{}, std::move(deck), full_key, {}, {}, {}, {}};
   fill(*flat);
   return flat;
}

void rk_deck_close(DeckView *handle) {
   delete static_cast<Flat *>(handle);
}

} // extern "C"
